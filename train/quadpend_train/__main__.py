"""`python -m quadpend_train` is the command `quadpend`."""

from quadpend_train.cli.main import main

main()
