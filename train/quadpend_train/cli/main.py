"""The command `quadpend`: train, evaluate, compare and more. `python -m quadpend_train` is the same.

This module and `commands` import no library at module level, so that `quadpend --help` starts at once.
"""

import os
import sys
import time
from typing import NoReturn

from quadpend_train.cli import commands
from quadpend_train.cli.commands import COMMANDS, run
from quadpend_train.common import interruption
from quadpend_train.common.text import brief, print_everywhere

_EXTRAS = {
    "train": (
        *("tyro", "torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tqdm", "rich", "matplotlib", "jinja2"),
        *("optuna", "cmaes", "filelock", "fsspec", "markupsafe", "PIL"),
    ),
    "view": ("pygame", "moviepy", "imageio", "imageio_ffmpeg"),
    "onnx": ("onnxruntime",),
    "mpc": ("casadi",),
    "cluster": ("ray",),
}
_TRACEBACK = "--traceback"
_LONGEST = 4000  # characters of a sentence


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Wrong input ends with one sentence on stderr and exit status 2.

    If a part of a study fails, all other parts are computed, and the exit status is 1.

    The option ``--traceback``, anywhere on the command line, prints the traceback before the sentence. The exit status
    is 130 after Ctrl-C, 143 after SIGTERM, and 141 if the reader of the output, such as ``head``, has closed it.

    Args:
        arguments: Command and its options; None takes those of the process, which then ends at once after SIGINT or
            SIGTERM, see `quadpend_train.common.interruption`.
    """
    print_everywhere()
    if arguments is None:
        interruption.end_at_signals()
    else:
        commands.started = time.perf_counter()
    given = sys.argv[1:] if arguments is None else arguments
    command = [argument for argument in given if argument != _TRACEBACK]
    interruption.advise(lambda: "".join(COMMANDS[name].interrupted for name in command[:1] if name in COMMANDS))
    try:
        try:
            run(command)
        finally:
            sys.stdout.flush()
            interruption.wait_for_end()
    except KeyboardInterrupt:
        print(interruption.sentence(), file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        _discard_output()
        sys.exit(141)
    except Exception as error:
        if not (sentence := _sentence(error)):
            raise
        if _TRACEBACK in given:
            import traceback

            traceback.print_exc()
        _exit(sentence, 1 if type(error).__name__ == "CallsFailedError" else 2)


def _discard_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes the output once more at exit


def _sentence(error: Exception) -> str:
    """Return the sentence about wrong input or about a missing package; empty for errors of the program."""
    if isinstance(error, ModuleNotFoundError):
        name = (error.name or "").partition(".")[0]
        extra = next((extra for extra, modules in _EXTRAS.items() if name in modules), "")
        return extra and f"this command needs {name}, which is not installed: pip install 'quadpend-gym[{extra}]'"
    from gymnasium.error import Error

    from quadpend_train.common.executors import CallsFailedError
    from quadpend_train.common.paths import describe_os_error

    if isinstance(error, CallsFailedError):
        return str(error)
    if isinstance(error, OSError):
        return describe_os_error(error)
    if isinstance(error, MemoryError):
        return f"there is too little memory: ask for less, such as fewer episodes or sub-environments{_details(error)}"
    if isinstance(error, RecursionError):
        return "a file or a text in JSON is nested too deeply"
    reported = (ValueError, TypeError, FloatingPointError, OverflowError, Error)
    return brief(error, _LONGEST) if isinstance(error, reported) else ""


def _details(error: MemoryError) -> str:
    return f" ({brief(error)})" if str(error) else ""


def _exit(sentence: str, status: int) -> NoReturn:
    print(f"quadpend: {sentence}", file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:  # the disk of the output is full
        _discard_output()
    sys.exit(status)
