"""The command `quadpend`: train, evaluate, watch and more. `python -m quadpend_train` is the same.

This module imports no library at module level, so that `quadpend --help` starts at once.
"""

import io
import os
import signal
import sys
import threading
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import Any

_TRACEBACK = "--traceback"
_EXTRAS = {
    "casadi": "mpc",
    "imageio": "view",
    "orangebox": "logs",
    "pyulog": "logs",
}  # of packages that are not in the extra train
_LONGEST = 4000  # characters of a sentence
_CONTINUING = {"evaluate", "preflight", "tune"}  # commands that begin with what an interrupted one has finished
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_received: list[int] = []  # signals that ended this command


# First lines of the docstrings of the functions below, whose parameters are the options
COMMANDS = {
    "list": "List policies, scenarios, settings, tasks, vehicles, and models of wind and sensors.",
    "train": "Train a policy.",
    "evaluate": "Evaluate policies in the same episodes and compare them with the first policy.",
    "preflight": "Print the data sheet of a policy on a vehicle: its limits beside what flights need.",
    "watch": "Show up to four policies side by side in the same episode, or one policy in up to four scenarios.",
    "export": "Convert a policy to a policy file, which executes no code when loaded, or to C.",
    "fly": "Fly a vehicle: motion capture by UDP, a policy in C with its supervisor, an autopilot by MSP.",
    "simulate": "Simulate a vehicle with its pole in real time, for a flight on the desk.",
    "replay": "Fly vehicles open loop under the motor commands of a flight log, and compare them with the log.",
    "identify": "Identify a vehicle from flight logs, and write its file and scenarios for training.",
    "tune": "Tune the gains of classical controllers: minimise the penalised RMSE in the training scenarios.",
}
FUNCTIONS = {
    "list": "listing.list_names",
    "train": "training.train",
    "evaluate": "evaluation.evaluate",
    "preflight": "preflight.preflight",
    "watch": "watch.watch",
    "export": "training.export",
    "fly": "flying.fly",
    "simulate": "flying.simulate",
    "replay": "flight_logs.replay",
    "identify": "flight_logs.identify",
    "tune": "search.tune",
}
_LINES = "\n".join(f"  {name:<11}{summary}" for name, summary in COMMANDS.items())
_OVERVIEW = f"""usage: quadpend COMMAND [OPTIONS]

A spherical inverted pendulum on a quadrotor in the wind: train policies and compare them.

commands:
{_LINES}

options:
  --help     `quadpend COMMAND --help` describes the options of a command.
  --version  Print the version.
  --traceback
             Print the Python traceback of an error, with any command.
"""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line, by default with the arguments of the process, which then also handles SIGTERM.

    The exit status is 2 with one sentence on stderr after wrong input, 1 if a part of a study failed, 130 after Ctrl-C,
    143 after SIGTERM, 129 after SIGHUP, and 141 if the reader of the output, such as ``head``, has closed it.
    """
    if arguments is None:
        for number in _SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:  # nohup
                signal.signal(number, _interrupt)
        sys.unraisablehook = _interrupt_again
        _replace_unknown_characters()
    given = sys.argv[1:] if arguments is None else arguments
    command = [argument for argument in given if argument != _TRACEBACK]
    try:
        _run(command)
        sys.stdout.flush()
    except KeyboardInterrupt as interruption:
        kept = "what is finished is saved, and the same command continues" if {*command[:1]} & _CONTINUING else ""
        with suppress(OSError):  # the terminal is closed
            print("\nInterrupted", *filter(None, [str(interruption) or kept]), sep=": ", file=sys.stderr)
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


def _replace_unknown_characters() -> None:
    """Let this process and those that it starts print "?" for what the terminal or the pipe cannot encode."""
    os.environ["PYTHONIOENCODING"] = os.environ.get("PYTHONIOENCODING", "").partition(":")[0] + ":replace"
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


class _Interruption(KeyboardInterrupt):
    """Python ends with SIGINT, in place of the exit status, if a KeyboardInterrupt itself has left `exec`."""


def _interrupt(number: int, _: Any) -> None:
    """Raise KeyboardInterrupt once: a second Ctrl-C would interrupt the end of the processes."""
    signal.signal(number, signal.SIG_IGN)
    _received.append(number)
    raise _Interruption


def _interrupt_again(lost: Any) -> None:
    """Repeat an interruption that came in a callback of C, such as numba's while it compiles, and was lost there."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    number = _received.pop()
    signal.signal(number, _interrupt)
    threading.Timer(0.1, os.kill, (os.getpid(), number)).start()


def _run(arguments: list[str]) -> None:
    """Parse a command with its options, and execute it."""
    name, *options = arguments or ["--help"]
    if name in ("--help", "-h"):
        print(_OVERVIEW, end="")
        return
    if name == "--version":
        from quadpend_gym import __version__

        print(f"quadpend {__version__}")
        return
    if name not in COMMANDS:
        from quadpend_gym.core.settings import suggest

        raise ValueError(
            f"there is no command {name!r}{suggest(name, COMMANDS)}; the commands are {', '.join(COMMANDS)}"
        )
    if sys.stderr.isatty() and "--help" not in options:
        print("Loading …", file=sys.stderr, flush=True)
    if name == "train" and {"--help", "-h"} & {*options}:
        from quadpend_train.cli.training_help import help_text

        print(help_text(options))
        return
    import tyro

    from quadpend_train.cli.options import checked

    module, function = FUNCTIONS[name].split(".")
    found = import_module(f"quadpend_train.cli.{module}")
    execute: Any = checked(getattr(found, function))
    if name == "train":  # the settings file determines the defaults of the other options
        execute = partial(execute, **found.default_settings(options))
    tyro.cli(execute, prog=f"quadpend {name}", args=options)


def _sentence(error: Exception) -> str:
    """Return the sentence about wrong input or about a missing package; empty for errors of the program."""
    if isinstance(error, ModuleNotFoundError):
        name = (error.name or "").partition(".")[0]
        install = f"pip install 'quadpend-gym[{_EXTRAS.get(name, 'train')}]'"
        return f"this command needs {name}, which is not installed: {install}"
    from gymnasium.error import Error

    from quadpend_train.common.executors import CallsFailedError
    from quadpend_train.common.text import brief

    if isinstance(error, OSError) and error.strerror:
        path = f"{error.filename}: " if error.filename else ""
        return f"a file cannot be read or written: {path}{error.strerror}"
    if isinstance(error, CallsFailedError):
        return str(error)
    reported = (ValueError, TypeError, OSError, FloatingPointError, Error)
    return brief(error, _LONGEST) if isinstance(error, reported) else ""
