"""Run calls in this process, in several processes, or on a Ray cluster.

Executors have the interface of `concurrent.futures`. `run` takes calls by name. A call that fails does not stop the
others and is named when they have ended, so a study gives the same results on every executor.
"""

import os
import signal
import sys
import warnings
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from itertools import islice
from typing import Any, TypeVar

from tqdm.auto import tqdm

from quadpend_gym.core.factories import describe_error
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
            reason = getattr(error, "cause", None) or error  # Ray wraps it
            if isinstance(error, BrokenProcessPool):
                reason = "its process was killed, perhaps for lack of memory: use fewer jobs"
            lines.append(f"  {named}: {brief(reason, _LONGEST)}")
        super().__init__("\n".join(lines))
        self.failures = dict(failures)


def executor(jobs: int = 1, cluster: str | None = None) -> Executor:
    """Return an executor with a number of processes, or on a Ray cluster: auto, local, HOST:PORT or ray://HOST:PORT."""
    if jobs < 1:
        raise ValueError(f"jobs must be at least 1, not {jobs}")
    if cluster is None:
        return _ThisProcess() if jobs == 1 else _Processes(jobs)
    if jobs != 1:
        raise ValueError("the cluster decides how many jobs run at once: give no --jobs with --cluster")
    return _Ray(cluster)


def run(
    calls: Mapping[Name, Call],
    jobs: int | Executor = 1,
    *,
    done: Callable[[Name, Any], object] = lambda name, result: None,
    what: str = "job",
    finished: int = 0,
) -> dict[Name, Any]:
    """Run calls, which can be pickled, with a progress bar, and return their results by name.

    `jobs` is the number of processes, or an executor. `done` is called in this process with the name and the result of
    each call that succeeds, as soon as it ends. A message about failures says what a call is (`what`). The progress bar
    begins with `finished` calls. CallsFailedError is raised when all calls have ended.
    """
    pool = executor(jobs) if isinstance(jobs, int) else jobs
    results: dict[Name, Any] = {}
    failures: dict[Name, BaseException] = {}
    with tqdm(total=len(calls) + finished, initial=finished, unit=what, leave=False) as bar:
        try:
            for name, future in _completed(calls, pool):
                if (error := future.exception()) is None:
                    results[name] = future.result()
                    done(name, results[name])
                else:
                    failures[name] = error
                bar.update()
        except BaseException:  # also an interruption: leave no process behind
            pool.shutdown(cancel_futures=True)
            raise
    if failures:
        raise CallsFailedError(failures, len(calls), what) from next(iter(failures.values()))
    return results


def _completed(calls: Mapping[Name, Call], pool: Executor) -> Iterator[tuple[Name, "Future[Any]"]]:
    """Yield calls as they end. Only a few are submitted at once: a killed process of loky fails all submitted ones."""
    waiting = iter(calls.items())
    running: dict[Future[Any], Name] = {}
    while True:
        for name, call in islice(waiting, getattr(pool, "ahead", 1) - len(running)):
            running[pool.submit(call)] = name
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(future), future


class _ThisProcess(Executor):
    """Make a call when it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        try:
            future.set_result(_described(partial(fn, *args, **kwargs)))
        except RuntimeError as error:
            future.set_exception(error)
        return future


class _Processes(Executor):
    """The processes of loky, which end with this process."""

    def __init__(self, jobs: int) -> None:
        self.ahead = jobs

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        call = partial(fn, *args, **kwargs)
        future: Future[Any] = self._pool().submit(_call_in_folder, call, os.getcwd(), sys.argv)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._pool().shutdown(wait, kill_workers=cancel_futures)

    def _pool(self) -> Any:
        from loky import get_reusable_executor

        # loky replaces processes that keep much memory, and those that were idle for 10 s as a call came.
        warnings.filterwarnings("ignore", "A worker (was restarted|stopped)")
        return get_reusable_executor(self.ahead, initializer=_ignore_interrupts)


def _described(call: Call) -> Any:
    """Make a call, and raise type, message and place of its exception, whose class another process may not have."""
    try:
        return call()
    except Exception as error:  # own code may raise exceptions of any type
        raise RuntimeError(describe_error(error)) from error


def _call_in_folder(call: Call, folder: str, command: list[str]) -> Any:
    """Make a call in a worker, which may be older than the working directory and the command line of the sender."""
    os.chdir(folder)
    sys.argv = command
    return _described(call)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which ends this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Ray(Executor):
    """A Ray cluster whose machines share the working directory and the packages of this process.

    Ray repeats a call whose worker or node dies, and ends the calls of a process that ends.
    """

    ahead = sys.maxsize

    def __init__(self, address: str) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray sends nothing about this machine
        import ray

        variables = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        options = {"log_to_driver": False, "logging_level": "ERROR", "ignore_reinit_error": True}
        try:
            ray.init(address, runtime_env={"env_vars": variables}, **options)
        except Exception as error:  # Ray raises plain ones, as where its start takes more than 30 s
            raise ValueError(f"there is no Ray cluster at {address}: {brief(error)}") from error
        self._task = ray.remote(max_retries=2)(_call_in_folder)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = self._task.remote(partial(fn, *args, **kwargs), os.getcwd(), sys.argv).future()
        return future
