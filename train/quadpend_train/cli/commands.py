"""The table of commands, and the parser of their options."""

import argparse
from functools import partial

import tyro

from quadpend_train.cli import evaluation, studies, training
from quadpend_train.cli.watch import watch
from quadpend_train.training.settings import ALGORITHMS, read_settings


def run(arguments: list[str]) -> None:
    """Parse a command with its options, and execute it.

    Args:
        arguments: Command and its options.

    Raises:
        Exception: If an option is wrong; see the functions of the commands.
    """
    # The settings file determines the defaults of the other options, so it is read before tyro parses them.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--settings")
    first.add_argument("--algo", choices=ALGORITHMS)
    first.add_argument("--start-from")
    known = first.parse_known_args(arguments)[0]
    default = known.settings or known.algo or training.settings_of(known.start_from)
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
