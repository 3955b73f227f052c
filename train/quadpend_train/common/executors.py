"""Executors run the calls of a study: in this process, in several processes, or on a Ray cluster.

All of them take calls by name and yield what the calls return, in the order in which they end. A call that fails by
itself yields its exception and does not stop the others. So a study is the same on every executor, and
`successes` reports what failed when everything else is done.

A call for another machine consists of data only. It may have these attributes:

- ``files()``: the files that it reads, besides the code;
- ``elsewhere()``: the call to execute in its place on another machine;
- ``cpus``: the number of processor cores that it uses.
"""

import re
from collections.abc import Callable, Generator, Hashable, Iterable, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol, TypeVar

from tqdm.auto import tqdm

from quadpend_gym.core.factories import describe_error
from quadpend_train.common.files import write_bytes
from quadpend_train.common.limits import check_counts
from quadpend_train.common.processes import call_in_processes
from quadpend_train.common.text import brief

Name = TypeVar("Name", bound=Hashable)
_LONGEST = 400  # characters of the message of a failure


class Call(Protocol):
    """A function without arguments."""

    def __call__(self) -> Any:
        """Return the result."""


class Executor(Protocol):
    """A function that runs calls."""

    def __call__(self, calls: Mapping[Name, Call]) -> Generator[tuple[Name, Any], None, None]:
        """Yield the names of calls with what they return or raise, as soon as they end.

        Args:
            calls: Functions that can be pickled, by any hashable name.
        """


class CallsFailedError(RuntimeError):
    """Some calls failed, and all others have ended.

    Args:
        failures: The exceptions by the names of the calls.
        calls: Number of all calls.
        what: What a call is, such as "job".
        kept: What happened to the results of the others, such as "are cached".
    """

    def __init__(self, failures: Mapping[Any, Exception], calls: int, what: str, kept: str) -> None:
        others = f"; the results of the others {kept}" if kept and calls > len(failures) else ""
        lines = [f"{len(failures)} of {calls} {what}s failed{others}:"]
        lines += [f"  {_text(name)}: {brief(_reason(error), _LONGEST)}" for name, error in failures.items()]
        super().__init__("\n".join(lines))
        self.failures = dict(failures)


def _text(name: Any) -> str:
    return ", ".join(map(str, name)) if isinstance(name, tuple) else str(name)


def _reason(error: Exception) -> str:
    """Return type, message and place of an exception, also of one from another process."""
    frames = re.findall(r'^  File "(.+)", line (\d+)', str(error.__cause__ or ""), re.MULTILINE)
    place = f" ({Path(frames[-1][0]).name}, line {frames[-1][1]})" if frames and not error.__traceback__ else ""
    return describe_error(error) + place


def call_here(
    calls: Mapping[Name, Call],
) -> Generator[tuple[Name, Any], None, None]:
    """Execute calls one after the other in this process, see `Executor`."""
    for name, call in calls.items():
        try:
            result = call()
        except Exception as error:  # own code may raise exceptions of any type
            result = error
        yield name, result


def executor(jobs: int = 1, cluster: str | None = None) -> Executor:
    """Return an executor.

    Args:
        jobs: Number of processes; 1 is this process.
        cluster: Ray cluster, see `quadpend_train.common.ray_executor`; None: this machine, without Ray.

    Raises:
        ModuleNotFoundError: If there is a cluster and Ray is not installed.
        ValueError: If `jobs` is out of range, or both are given.
    """
    check_counts(jobs=jobs)
    if cluster is None:
        return call_here if jobs == 1 else partial(call_in_processes, processes=jobs)
    if jobs != 1:
        raise ValueError("the cluster decides how many jobs run at once: give no --jobs with --cluster")
    from quadpend_train.common.ray_executor import RayExecutor

    return RayExecutor(cluster)


def as_executor(jobs: "int | Executor") -> Executor:
    """Return an executor, or that of a number of processes."""
    return jobs if callable(jobs) else executor(jobs)


def successes(
    outcomes: Generator[tuple[Name, Any], None, None], what: str = "job", kept: str = ""
) -> Generator[tuple[Name, Any], None, None]:
    """Yield the results of calls that succeed, and name the others when all calls have ended.

    Args:
        outcomes: What an executor yields.
        what: What a call is, for the message.
        kept: What happened to the results of the others, for the message.

    Raises:
        CallsFailedError: If calls failed.
    """
    failures, calls = {}, 0
    with closing(outcomes):
        for name, outcome in outcomes:
            calls += 1
            if isinstance(outcome, Exception):
                failures[name] = outcome
            else:
                yield name, outcome
    if failures:
        raise CallsFailedError(failures, calls, what, kept) from next(iter(failures.values()))


class FolderCall(NamedTuple):
    """A call that writes files into a folder.

    Another machine writes them into a temporary folder, and returns them for `keep`.

    Attributes:
        write: Function of the folder. If it is interrupted, it continues with the files that it has written.
        folder: The folder.
        inputs: Other files that it reads.
        cpus: Number of processor cores that it uses.
    """

    write: Callable[[Path], object]
    folder: Path
    inputs: tuple[Path, ...] = ()
    cpus: int = 1

    def __call__(self) -> dict[str, bytes]:
        """Write the files, and return none."""
        self.write(self.folder)
        return {}

    def files(self) -> Iterable[Path]:
        """Return the files that it reads, besides those in the folder."""
        return self.inputs

    def elsewhere(self) -> Callable[[], dict[str, bytes]]:
        """Return a call that returns the files, with those that the folder has now."""
        return partial(_write_elsewhere, self.write, _contents(self.folder))

    def keep(self, files: Mapping[str, bytes]) -> None:
        """Make the folder contain the files that another machine returned; without any, do nothing."""
        for name, content in files.items():
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_bytes(self.folder / name, content)
        for name in set(_contents(self.folder)) - set(files) if files else ():
            (self.folder / name).unlink()


def run_folder_calls(calls: Mapping[Name, FolderCall], execute: Executor, total: int, unit: str, kept: str) -> None:
    """Run trainings that write into folders, with a progress bar.

    Args:
        calls: The calls by name.
        execute: Executor that runs them.
        total: Number of all trainings, those included that need no call.
        unit: What the progress bar counts.
        kept: What happened to the files of finished trainings, for the message about failed ones.

    Raises:
        CallsFailedError: If trainings failed, when all others have ended.
    """
    with (
        tqdm(total=total, initial=total - len(calls), unit=unit, leave=False) as bar,
        closing(successes(execute(calls), "training", kept)) as done,
    ):
        for name, files in done:
            calls[name].keep(files)
            bar.update()


def _write_elsewhere(write: Callable[[Path], object], files: Mapping[str, bytes]) -> dict[str, bytes]:
    with TemporaryDirectory() as temporary:
        folder = Path(temporary, "folder")
        for name, content in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        write(folder)
        return _contents(folder)


def _contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder by their relative paths, in the order in which they were written; no hidden ones."""
    files = [file for file in folder.rglob("*") if file.is_file() and not file.name.startswith(".")]
    files.sort(key=lambda file: file.stat().st_mtime_ns)
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}
