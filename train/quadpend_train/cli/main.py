"""The command `quadpend`: train, evaluate, watch and more. `python -m quadpend_train` is the same.

This module imports no library at module level, so that `quadpend --help` starts at once.
"""

import os
import re
import signal
import sys
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

_CACHED = "finished results are cached, and the same command continues"
_SAVED = "finished trials are saved, and the same command continues"
_TRACEBACK = "--traceback"
_LONGEST = 4000  # characters of a sentence
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_received: list[int] = []  # signals that ended this command


class Command(NamedTuple):
    """A command of `quadpend`.

    Attributes:
        function: Module in this folder and name of the function, whose parameters are the options of the command.
        summary: First line of the docstring of the function.
        interrupted: What happens to the results after Ctrl-C, unless the interrupted function says it.
    """

    function: str
    summary: str
    interrupted: str = "the same command starts again"


COMMANDS = {
    "list": Command(
        "listing.list_names", "List policies, scenarios, settings, tasks, vehicles, and models of wind and sensors."
    ),
    "train": Command("training.train", "Train a policy."),
    "evaluate": Command(
        "evaluation.evaluate", "Evaluate policies in the same episodes and compare them with the first policy.", _CACHED
    ),
    "watch": Command("watch.watch", "Show policies side by side in the same episode, in a window or in a file."),
    "card": Command("cards.card", "Describe a policy: what it observes, how it was trained, and how good it is."),
    "export": Command("training.export", "Convert a model to a policy file, which executes no code when loaded."),
    "reproduce": Command(
        "training.reproduce", "Train a learned policy again from its card, and report whether the weights are the same."
    ),
    "tune": Command(
        "search.tune",
        "Tune the gains of classical controllers: minimise the penalised RMSE in the training scenarios.",
        _SAVED,
    ),
    "sweep": Command(
        "search.sweep",
        "Search for settings of a learner: each trial is a brief training, scored by the penalised RMSE of its policy.",
        _SAVED,
    ),
    "paper": Command("paper.paper", "Repeat the experiment of the paper and draw its Figures 4 to 10."),
}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Wrong input ends with one sentence on stderr and exit status 2.

    If a part of a study fails, all other parts are computed, and the exit status is 1.

    The option ``--traceback``, anywhere on the command line, prints the traceback before the sentence. The exit status
    is 130 after Ctrl-C, 143 after SIGTERM, and 141 if the reader of the output, such as ``head``, has closed it.

    Args:
        arguments: Command and its options; None takes those of the process, which then also handles SIGTERM.
    """
    if arguments is None:
        for number in _SIGNALS:
            signal.signal(number, _interrupt)
    given = sys.argv[1:] if arguments is None else arguments
    command = [argument for argument in given if argument != _TRACEBACK]
    try:
        _run(command)
        sys.stdout.flush()
    except KeyboardInterrupt as interruption:
        kept = [COMMANDS[name].interrupted for name in command[:1] if name in COMMANDS]
        print(f"\nInterrupted: {str(interruption) or ''.join(kept)}", file=sys.stderr)
        sys.exit(128 + (_received or [signal.SIGINT])[0])
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes the output once more at exit
        sys.exit(141)
    except Exception as error:
        if not (sentence := _sentence(error)):
            raise
        if _TRACEBACK in given:
            import traceback

            traceback.print_exc()
        print(f"quadpend: {sentence}", file=sys.stderr)
        sys.exit(1 if type(error).__name__ == "CallsFailedError" else 2)


def _interrupt(number: int, _: Any) -> None:
    """Raise KeyboardInterrupt once: a second Ctrl-C would interrupt the end of the processes."""
    signal.signal(number, signal.SIG_IGN)
    _received.append(number)
    raise KeyboardInterrupt


def _overview() -> str:
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


def _run(arguments: list[str]) -> None:
    """Parse a command with its options, and execute it."""
    name, *options = arguments or ["--help"]
    if name in ("--help", "-h"):
        print(_overview(), end="")
    elif name == "--version":
        from quadpend_gym import __version__

        print(f"quadpend {__version__}")
    elif name in COMMANDS:
        _execute(name, options)
    else:
        from quadpend_gym.core.settings import suggest

        raise ValueError(
            f"there is no command {name!r}{suggest(name, COMMANDS)}; the commands are {', '.join(COMMANDS)}"
        )


def _execute(name: str, options: list[str]) -> None:
    import tyro

    from quadpend_train.cli.options import checked

    module, function = COMMANDS[name].function.split(".")
    found = import_module(f"quadpend_train.cli.{module}")
    execute: Any = checked(getattr(found, function))
    if name == "train":  # the settings file determines the defaults of the other options
        execute = partial(execute, **found.default_settings(options))
    tyro.cli(execute, prog=f"quadpend {name}", args=options)


def _sentence(error: Exception) -> str:
    """Return the sentence about wrong input or about a missing package; empty for errors of the program."""
    if isinstance(error, ModuleNotFoundError):
        from importlib.metadata import requires

        name = (error.name or "").partition(".")[0]
        pattern = re.compile(rf"{re.escape(name.replace('_', '-'))}\b.*extra == ['\"](\w+)['\"]", re.IGNORECASE)
        extra = next((found[1] for line in requires("quadpend-gym") or () if (found := pattern.match(line))), "")
        return extra and f"this command needs {name}, which is not installed: pip install 'quadpend-gym[{extra}]'"
    from gymnasium.error import Error

    from quadpend_train.common.executors import CallsFailedError
    from quadpend_train.common.text import brief

    if isinstance(error, CallsFailedError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        path = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
        return f"a file cannot be read or written: {path}{error.strerror}"
    reported = (ValueError, TypeError, OSError, FloatingPointError, Error)
    return brief(error, _LONGEST) if isinstance(error, reported) else ""
