"""The command `quadpend`: train, evaluate, compare and more; `python -m train` is the same."""

import argparse
import sys
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import tyro
from gymnasium.error import Error

from quadpend_train.cli import commands
from quadpend_train.cli.watch import watch
from quadpend_train.training.settings import ALGORITHMS, read_settings


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; wrong input ends with one sentence and exit status 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        _run(arguments)
    except (
        ValueError,
        TypeError,
        FloatingPointError,
        FileNotFoundError,
        FileExistsError,
        BrokenProcessPool,
        Error,
    ) as error:
        print(f"quadpend: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def _run(arguments: list[str]) -> None:
    # The settings file gives the defaults of the other options, so it is read first.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--settings")
    first.add_argument("--algo", choices=ALGORITHMS)
    given = first.parse_known_args(arguments)[0]
    default = given.settings or given.algo or commands.DEFAULT_SETTINGS
    chosen = read_settings(default)

    tyro.extras.subcommand_cli_from_dict(
        {
            "train": partial(commands.train, run=chosen, settings=default),
            "export": commands.export,
            "card": commands.card,
            "reproduce": commands.reproduce,
            "evaluate": commands.evaluate,
            "compare": commands.compare,
            "tune": commands.tune,
            "ablate": commands.ablate,
            "watch": watch,
            "wind": commands.wind,
            "paper": commands.paper,
        },
        prog="quadpend",
        description="A spherical inverted pendulum on a quadrotor: train policies and compare them.",
        args=arguments,
    )
