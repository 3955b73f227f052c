"""Run calls by name, in this process or in several.

A call that fails does not stop the others and is named when they have ended, so a study gives the same results with any
number of processes.
"""

import os
import signal
import warnings
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from itertools import islice
from typing import Any, TypeVar

from quadpend_gym.core.factories import describe_error
from quadpend_train.common.interruptions import progress_bar
from quadpend_train.common.text import brief

Name = TypeVar("Name", bound=Hashable)
Call = Callable[[], Any]
_LONGEST = 400  # characters of the message of a failure


class CallsFailedError(RuntimeError):
    """Some calls failed, and all others have ended; see `run`."""

    def __init__(self, failures: Mapping[Any, BaseException], calls: int, what: str) -> None:
        lines = [f"{len(failures)} of {calls} {what}s failed; the others have ended:"]
        for name, error in failures.items():
            named = ", ".join(map(str, name)) if isinstance(name, tuple) else name
            killed = isinstance(error, BrokenProcessPool)
            reason: Any = "its process was killed, perhaps for lack of memory: use fewer jobs" if killed else error
            lines.append(f"  {named}: {brief(reason, _LONGEST)}")
        super().__init__("\n".join(lines))


def run(calls: Mapping[Name, Call], jobs: int = 1, *, what: str = "job", finished: int = 0) -> dict[Name, Any]:
    """Run calls, which can be pickled, with a progress bar, and return their results by name.

    `jobs` is the number of processes. A message about failures says what a call is (`what`). The progress bar begins
    with `finished` calls. CallsFailedError is raised when all calls have ended.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, not {jobs}")
    results: dict[Name, Any] = {}
    failures: dict[Name, BaseException] = {}
    ended = {name: partial(_described, call) for name, call in calls.items()}.items() if jobs == 1 else None
    with progress_bar(total=len(calls) + finished, initial=finished, unit=what, leave=False) as bar:
        try:
            for name, result in ended or _in_processes(calls, jobs):
                try:
                    results[name] = result()
                except Exception as error:
                    failures[name] = error
                bar.update()
        except BaseException:  # also an interruption: leave no process behind
            if not ended:
                pool(jobs).shutdown(kill_workers=True)
            raise
    if failures:
        raise CallsFailedError(failures, len(calls), what) from next(iter(failures.values()))
    return results


def _in_processes(calls: Mapping[Name, Call], jobs: int) -> Iterator[tuple[Name, Call]]:
    """Yield calls as they end in processes of loky, which end with this one, with functions that return the results.

    Only as many are submitted as there are processes: a killed process of loky fails all submitted ones.
    """
    waiting = iter(calls.items())
    running: dict[Future[Any], Name] = {}
    while True:
        for name, call in islice(waiting, jobs - len(running)):
            running[pool(jobs).submit(_call_in_folder, call, os.getcwd())] = name
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(future), future.result


def pool(jobs: int) -> Any:
    """Return the processes of loky."""
    from loky import get_reusable_executor

    # loky replaces processes that keep much memory, and those that were idle for 10 s as a call came.
    warnings.filterwarnings("ignore", "A worker (was restarted|stopped)")
    return get_reusable_executor(jobs, initializer=_ignore_interrupts)


def _described(call: Call) -> Any:
    """Make a call, and raise type, message and place of its exception, whose class another process may not have."""
    try:
        return call()
    except Exception as error:  # own code may raise exceptions of any type
        raise RuntimeError(describe_error(error)) from error


def _call_in_folder(call: Call, folder: str) -> Any:
    """Make a call in a worker, which may be older than the working directory of the sender."""
    os.chdir(folder)
    return _described(call)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which ends this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
