"""The command `quadpend`: train, evaluate, compare and more. `python -m quadpend_train` is the same."""

import sys
from concurrent.futures.process import BrokenProcessPool
from typing import NoReturn

from gymnasium.error import Error


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Wrong input ends with one sentence on stderr and exit status 2.

    Args:
        arguments: Command and its options; None takes those of the process.
    """
    try:
        from quadpend_train.cli.commands import run
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("quadpend"):
            raise
        _exit(f"{error}: pip install 'quadpend-gym[train,view]' installs what the commands need")
    try:
        run(sys.argv[1:] if arguments is None else arguments)
    except (
        ValueError,
        TypeError,
        FloatingPointError,
        FileNotFoundError,
        FileExistsError,
        BrokenProcessPool,
        Error,
    ) as error:
        _exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)


def _exit(message: str) -> NoReturn:
    print(f"quadpend: {message}", file=sys.stderr)
    sys.exit(2)
