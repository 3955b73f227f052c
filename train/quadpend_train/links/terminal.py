"""Keys of a terminal or a pipe, real-time priority, and one line that is written again and again."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

END = ""  # in place of a key: the terminal or the pipe is closed


def pressed() -> list[str]:
    """Return the keys that were pressed since the last call."""
    keys: list[str] = []
    stream = sys.stdin.fileno()
    while select.select([stream], [], [], 0.0)[0]:
        data = os.read(stream, 64).decode(errors="replace")
        keys += [*data] or [END]
        if not data:
            break
    return keys


@contextmanager
def keys_at_once() -> Iterator[None]:
    """Let a terminal give each key when it is pressed, without showing it."""
    if not sys.stdin.isatty():
        yield
        return
    import termios
    import tty

    settings = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    at_once = termios.tcgetattr(sys.stdin)
    at_once[0] &= ~termios.IXON  # Ctrl-S would stop the output, and the flight with it
    termios.tcsetattr(sys.stdin, termios.TCSANOW, at_once)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, settings)


def prefer() -> bool:
    """Ask the system to run this process before all ordinary ones; return whether it does."""
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
        return True
    return False


def show(line: str, is_new: bool) -> None:
    """Write a line over the one before in a terminal; elsewhere write new ones only."""
    if sys.stdout.isatty():
        sys.stdout.write(f"\r\x1b[K{line}" + "\n" * is_new)
    elif is_new:
        sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
