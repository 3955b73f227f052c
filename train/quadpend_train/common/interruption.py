"""End the command line within two seconds after SIGINT (Ctrl-C) or SIGTERM, whatever it is doing.

The signals are blocked, and a thread waits for them: the main thread may be importing a library, compiling a kernel or
writing a file, where an exception from a signal handler comes late or leaves something half done. The thread ends all
child processes, removes unfinished temporary files, prints how to go on, and ends the process with exit status 130 for
SIGINT or 143 for SIGTERM.

Only the command line calls `end_at_signals`. A program that imports this package keeps its own signal handlers.
This module imports only light modules, since it is the first to be imported.
"""

import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

unfinished: set[str] = set()  # temporary files and folders that this process is writing, without symbolic links
groups: set[int] = set()  # process groups of the workers of this process
SIGNALS = (signal.SIGINT, signal.SIGTERM)
_FLUSH_SECONDS, _CHILDREN_SECONDS = 0.2, 0.5  # longest waiting times
_advice: Callable[[], str] = str
_ending = threading.RLock()  # a handler may interrupt the thread that has it


def advise(advice: Callable[[], str]) -> None:
    """Set the function that says what an interruption has kept, and which command continues."""
    global _advice
    _advice = advice


def sentence() -> str:
    """Return the line that is printed after an interruption."""
    return f"Interrupted: {_advice() or 'the same command starts again'}"


def wait_for_end() -> None:
    """Return at once, except if a signal is about to end this process."""
    with _ending:
        pass


def end_at_signals() -> None:
    """Let SIGINT and SIGTERM end this process from now on. On systems without signal masks, nothing changes."""
    if not hasattr(signal, "pthread_sigmask"):
        return
    threading.Thread(target=_wait, daemon=True, name="signals").start()
    for number in SIGNALS:  # the handlers run only if a library unblocks the signals
        signal.signal(number, _handle)
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)


def _wait() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    _end(signal.sigwait(SIGNALS))


def _handle(number: int, _: Any) -> None:
    _end(number)


def _end(number: int) -> NoReturn:
    """End this process and its children. A second call waits for the first."""
    _ending.acquire()
    try:
        _end_children()
        _print(sentence())
    finally:
        _remove_unfinished()  # the last step: the main thread may have been about to create a file
        os._exit(128 + number)


def _remove_unfinished() -> None:
    for path in unfinished.copy():
        shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):
            os.unlink(path)


def begin_file(path: str) -> None:
    """Add a path to `unfinished`; if a signal is about to end this process, wait for the end."""
    unfinished.add(path)
    wait_for_end()


def _end_children() -> None:
    """Kill all child processes and wait for their ends; the main thread may be starting one."""
    end = time.monotonic() + _CHILDREN_SECONDS
    while _kill_all() and time.monotonic() < end:
        time.sleep(0.01)
        with suppress(ChildProcessError):  # there is none
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def _kill_all() -> bool:
    """Kill the groups of the workers and all descendants, and return whether there were any descendants."""
    for group in groups.copy():  # of a killed worker, they contain processes that are no descendants any more
        kill_group(group)
    processes = descendants(os.getpid())
    for process in processes:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    return bool(processes)


def kill_group(group: int) -> None:
    """Kill the processes of a group, if there are any."""
    if os.name == "posix":
        with suppress(ProcessLookupError, PermissionError):  # on macOS, processes that have ended give no permission
            os.killpg(group, signal.SIGKILL)


def _print(line: str) -> None:
    """Write what is buffered for stdout and then a line to stderr, below a progress bar if there is one."""

    def write() -> None:
        with suppress(Exception):
            sys.stdout.flush()
        start, bars = "", getattr(sys.modules.get("tqdm"), "tqdm", None)
        if bars is not None and getattr(bars, "_instances", None):
            start = "\n"
            with suppress(Exception):
                bars.get_lock().acquire(timeout=_FLUSH_SECONDS / 2.0)  # stops the bars
        with suppress(OSError):
            os.write(2, f"{start}{line}\n".encode(errors="replace"))

    # A reader of the output that has stopped must not delay the end.
    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    writer.join(_FLUSH_SECONDS)


def descendants(process: int) -> list[int]:
    """Return the children of a process and their children. Except on Linux, an empty list.

    On other systems, children end by themselves when their pipe to this process is closed.
    """
    parents: dict[int, int] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):
            fields = path.read_text(errors="replace").rpartition(")")[2].split()  # a name may contain spaces
            if fields[0] not in "ZX":  # it has not ended
                parents[int(path.parent.name)] = int(fields[1])
    found = [process]
    for ancestor in found:
        found += [child for child, parent in parents.items() if parent == ancestor]
    return found[1:]
