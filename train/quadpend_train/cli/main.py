"""The command `quadpend`: train, evaluate, compare and more. `python -m quadpend_train` is the same."""

import argparse
import sys
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import tyro
from gymnasium.error import Error

from quadpend_train.cli import evaluation, studies, training
from quadpend_train.cli.watch import watch
from quadpend_train.training.settings import ALGORITHMS, read_settings


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Wrong input ends with one sentence on stderr and exit status 2.

    Args:
        arguments: Command and its options; None takes those of the process.
    """
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
    # The settings file determines the defaults of the other options, so it is read before tyro parses them.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--settings")
    first.add_argument("--algo", choices=ALGORITHMS)
    known = first.parse_known_args(arguments)[0]
    default = known.settings or known.algo or training.DEFAULT_SETTINGS
    settings = read_settings(default)

    tyro.extras.subcommand_cli_from_dict(
        {
            "train": partial(training.train, run=settings, settings=default),
            "export": training.export,
            "card": training.card,
            "reproduce": training.reproduce,
            "evaluate": evaluation.evaluate,
            "compare": evaluation.compare,
            "watch": watch,
            "tune": studies.tune,
            "ablate": studies.ablate,
            "wind": studies.wind,
            "paper": studies.paper,
        },
        prog="quadpend",
        description="A spherical inverted pendulum on a quadrotor: train policies and compare them.",
        args=arguments,
    )
