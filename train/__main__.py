"""`python -m train` is the command `quadpend`."""

from train.cli import main

main()
