"""Run the command `quadpend` by `python -m quadpend_train`."""

from quadpend_train.cli.main import main

main()
