"""The table of commands, and the function that runs one of them."""

import time
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

started = time.perf_counter()  # of the command, which counts max_seconds from here; a later `main` sets it again
_RESULTS_ARE_CACHED = "finished results are cached, and the same command continues"


class Command(NamedTuple):
    """A command of `quadpend`.

    Attributes:
        function: Module in this folder and name of the function, whose parameters are the options of the command.
        summary: First line of the docstring of the function.
        interrupted: What happens to the results after Ctrl-C; empty if the command prints it itself or has none.
    """

    function: str
    summary: str
    interrupted: str = ""


COMMANDS = {
    "list": Command(
        "listing.list_names", "List policies, scenarios, settings, tasks, vehicles, and models of wind and sensors."
    ),
    "train": Command("training.train", "Train PPO, SAC, TQC or APG."),
    "evaluate": Command(
        "evaluation.evaluate",
        "Evaluate policies in the same episodes and compare them with the first policy.",
        _RESULTS_ARE_CACHED,
    ),
    "compare": Command(
        "evaluation.compare",
        "Compare two policies: print in which scenarios each of them wins, by how much, and how certain that is.",
        _RESULTS_ARE_CACHED,
    ),
    "watch": Command("watch.watch", "Show policies side by side in the same episode, in a window or in a file."),
    "card": Command("cards.card", "Describe a policy: what it observes, how it was trained, and how good it is."),
    "export": Command("training.export", "Convert a model to a policy file, which executes no code when loaded."),
    "reproduce": Command(
        "training.reproduce", "Train a learned policy again from its card, and report whether the weights are the same."
    ),
    "tune": Command(
        "studies.tune",
        "Tune the gains of classical controllers: minimise the penalised RMSE in the training scenarios.",
        "finished trials are saved, and the same command continues",
    ),
    "sweep": Command(
        "studies.sweep",
        "Search for settings of a learner: each trial is a brief training, scored by the penalised RMSE of its policy.",
        "finished trials are saved, and the same command continues",
    ),
    "ablate": Command(
        "studies.ablate",
        "Train with and without each part of a learner, and tabulate the differences.",
        "finished runs are saved, and the same command continues",
    ),
    "situation": Command(
        "studies.situation",
        "Measure what a policy gains from observing its own situation, compared with the mean one.",
        _RESULTS_ARE_CACHED,
    ),
    "vehicles": Command(
        "result_pages.vehicles",
        "Measure how well policies fly real vehicles: in wind, from large tilts, and as flown in an experiment.",
        _RESULTS_ARE_CACHED,
    ),
    "tasks": Command(
        "result_pages.tasks",
        "Measure how well policies swing the pendulum up, carry a load, recover, or follow fast references.",
        _RESULTS_ARE_CACHED,
    ),
    "bound": Command(
        "bound.bound",
        "Plan the best flight of each episode, with all wind known in advance, and measure the gap of policies to it.",
        "planned episodes are saved, and the same command continues",
    ),
    "wind": Command("studies.wind", "Plot models of wind, and the effects of sensors and actuators."),
    "paper": Command("studies.paper", "Repeat the experiment of the paper and draw its Figures 4 to 10."),
}


def overview() -> str:
    """Return the text of `quadpend --help`."""
    lines = "\n".join(f"  {name:<11}{command.summary}" for name, command in COMMANDS.items())
    return f"""usage: quadpend COMMAND [OPTIONS]

A spherical inverted pendulum on a quadrotor in the wind: train policies and compare them.

commands:
{lines}

options:
  --help     `quadpend COMMAND --help` describes the options of a command.
  --version  Print the version.
  --traceback
             Print the Python traceback of an error, with any command.
"""


def run(arguments: list[str]) -> None:
    """Parse a command with its options, and execute it.

    Args:
        arguments: Command and its options.

    Raises:
        Exception: If there is no such command, or an option is wrong; see the functions of the commands.
    """
    name, *options = arguments or ["--help"]
    if name in ("--help", "-h"):
        print(overview(), end="")
    elif name == "--version":
        from quadpend_gym import __version__

        print(f"quadpend {__version__}")
    elif name in COMMANDS:
        _execute(name, options)
    else:
        from quadpend_gym.core.validation import suggest

        raise ValueError(
            f"there is no command {name!r}{suggest(name, COMMANDS)}; the commands are {', '.join(COMMANDS)}"
        )


def _execute(name: str, options: list[str]) -> None:
    import tyro

    module, function = COMMANDS[name].function.split(".")
    found = import_module(f"quadpend_train.cli.{module}")
    execute: Any = getattr(found, function)
    if name == "train":  # the settings file determines the defaults of the other options
        execute = partial(execute, **found.default_settings(options))
    tyro.cli(execute, prog=f"quadpend {name}", args=options)
