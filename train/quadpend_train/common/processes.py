"""Call functions in other processes.

A worker ends when this process ends, in whatever way. If a worker is killed, its call is repeated in another one.
"""

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
Result = TypeVar("Result")
_MOST_ATTEMPTS = 3  # at one call


def call_in_processes(
    calls: Mapping[Name, Callable[[], Result]], processes: int
) -> Generator[tuple[Name, Result], None, None]:
    """Yield the names of calls and what they return as soon as it is ready.

    Args:
        calls: Functions that can be pickled, by any hashable name.
        processes: Largest number of processes.

    Raises:
        ChildProcessError: If the processes of one call were killed three times.
        Exception: What a call raises.
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
                    result, error, raised_at = worker.answer()
                except (EOFError, OSError):
                    interruption.wait_for_end()
                    if attempts[name] == _MOST_ATTEMPTS:
                        raise ChildProcessError(
                            f"the processes of {name} were killed {_MOST_ATTEMPTS} times, perhaps for lack of memory:"
                            " use fewer jobs"
                        ) from None
                    waiting.append(name)
                    workers.remove(worker)
                    worker.kill()
                    workers.append(worker := _Worker())
                    assign(worker)
                    continue
                if error is not None:
                    raise error from RuntimeError(f"in another process:\n{raised_at}")
                assign(worker)
                yield name, result
    finally:
        for worker in workers:
            worker.kill()


class _Worker:
    """A process that executes one call after the other."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other,), daemon=True)
        with _blocked_signals():
            self.process.start()
        other.close()  # so that the end of the process closes the pipe

    def begin(self, call: Callable[[], Any]) -> None:
        """Send a call to the process."""
        with suppress(BrokenPipeError, ConnectionResetError):  # a killed process is found by `answer`
            self.connection.send(call)

    def answer(self) -> tuple[Any, Exception | None, str]:
        """Return what the call returned, or the exception that it raised and its traceback.

        Raises:
            EOFError: If the process has ended.
            OSError: If the process has ended while it sent the result.
        """
        result, error, raised_at = self.connection.recv()
        return result, error, raised_at

    def kill(self) -> None:
        """End the process, and wait for its end."""
        self.process.kill()
        self.process.join()
        self.connection.close()


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
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            connection.send_bytes(_answer(connection.recv_bytes()))


def _answer(call: bytes) -> bytes:
    """Execute a pickled call, and return what it returned, the exception that it raised and its traceback, pickled."""
    try:
        return pickle.dumps((pickle.loads(call)(), None, ""))
    except Exception as error:
        raised_at = traceback.format_exc()
        try:
            answer = pickle.dumps((None, error, raised_at))
            pickle.loads(answer)
        except Exception:  # the exception cannot be pickled
            return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}"), raised_at))
        return answer


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
