"""Call functions in other processes.

A worker ends when this process ends, in whatever way. If a worker is killed, its call is repeated in another one. A
call that raises an exception does not stop the others.
A call may start processes of its own. Except on Windows, a worker is the leader of a process group, and the processes
in this group end with the worker.
"""

import atexit
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from quadpend_train.common import interruption
from quadpend_train.common.interruption import SIGNALS

Name = TypeVar("Name", bound=Hashable)
MOST_ATTEMPTS = 3  # at one call


def call_in_processes(
    calls: Mapping[Name, Callable[[], Any]], processes: int
) -> Generator[tuple[Name, Any], None, None]:
    """Yield the names of calls and what they return or raise, as soon as they end.

    If the processes of one call are killed three times, its exception is a `ChildProcessError`.

    Args:
        calls: Functions that can be pickled, by any hashable name.
        processes: Largest number of processes.
    """
    waiting, attempts = list(calls)[::-1], dict.fromkeys(calls, 0)
    workers = [_Worker() for _ in range(min(processes, len(calls)))]
    running: dict[Any, tuple[_Worker, Name]] = {}

    def assign(worker: _Worker) -> None:
        if waiting:
            name = waiting.pop()
            attempts[name] += 1
            running[worker.connection] = worker, name
            worker.begin(calls[name])

    try:
        for worker in workers:
            assign(worker)
        while running:
            for ready in wait(list(running)):
                worker, name = running.pop(ready)
                try:
                    outcome = worker.answer()
                except (EOFError, OSError):
                    interruption.wait_for_end()
                    workers.remove(worker)
                    worker.kill()
                    workers.append(worker := _Worker())
                    if attempts[name] < MOST_ATTEMPTS:
                        waiting.append(name)
                        assign(worker)
                        continue
                    outcome = killed()
                assign(worker)
                yield name, outcome
    finally:
        for worker in workers:
            worker.kill()


def killed(advice: str = "use fewer jobs") -> ChildProcessError:
    """Return the exception of a call whose processes were always killed."""
    return ChildProcessError(f"its processes were killed {MOST_ATTEMPTS} times, perhaps for lack of memory: {advice}")


class _Worker:
    """A process that executes one call after the other."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other,), daemon=False)  # a daemon starts no processes
        with _blocked_signals():
            self.process.start()
        self.group: int = self.process.pid  # type: ignore[assignment]
        interruption.groups.add(self.group)
        atexit.register(self.kill)  # before multiprocessing waits for the end of the process
        other.close()  # so that the end of the process closes the pipe

    def begin(self, call: Callable[[], Any]) -> None:
        """Send a call to the process."""
        with suppress(BrokenPipeError, ConnectionResetError):  # a killed process is found by `answer`
            self.connection.send(call)

    def answer(self) -> Any:
        """Return what the call returned, or the exception that it raised.

        Raises:
            EOFError: If the process has ended.
            OSError: If the process has ended while it sent the result.
        """
        return read_answer(self.connection.recv_bytes())

    def kill(self) -> None:
        """End the process and those that it has started, and wait for its end."""
        self.process.kill()  # before its group, which it may be about to make
        interruption.kill_group(self.group)
        self.process.join()
        interruption.groups.discard(self.group)
        self.connection.close()
        atexit.unregister(self.kill)  # last, since a second Ctrl-C may interrupt this


@contextmanager
def _blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM, so that a new process inherits this. It unblocks them when it can end quietly.

    The resource tracker of multiprocessing, which starts with the first process, unblocks them also in this process.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(connection: "Connection[Any, Any]") -> None:
    """Execute calls until the pipe is closed."""
    if os.name == "posix":
        os.setpgid(0, 0)
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            connection.send_bytes(answer(connection.recv_bytes()))


def answer(call: bytes) -> bytes:
    """Execute a pickled call, and return what it returned, the exception that it raised and its traceback, pickled."""
    try:
        return pickle.dumps((pickle.loads(call)(), None, ""))
    except Exception as error:
        raised_at = traceback.format_exc()
        try:
            pickled = pickle.dumps((None, error, raised_at))
            pickle.loads(pickled)
        except Exception:  # the exception cannot be pickled
            return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}"), raised_at))
        return pickled


def read_answer(pickled: bytes) -> Any:
    """Return what a call returned, or the exception that it raised, whose cause has the traceback; see `answer`."""
    result, error, raised_at = pickle.loads(pickled)
    if error is None:
        return result
    error.__cause__ = RuntimeError(f"in another process:\n{raised_at}")
    return error


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        interruption.kill_group(os.getpid())
        os._exit(1)


def process_is_alive(process: int) -> bool:
    """Return whether a process of this host is running. On Windows, which has no safe way to ask, always True."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # the process of another user
        return True
    return True
