"""The executor that runs calls on a Ray cluster.

Ray's runtime environment gives the workers the code and the files of `quadpend_train.common.bundle` as their working
directory. The workers return pickled results, and only this process writes files.

A call whose worker or node dies is executed again, up to three times in all. A worker whose packages have other
versions than those of this process is refused, since its results could differ.
"""

import os
import pickle
import re
import signal
import socket
import threading
from collections.abc import Callable, Generator, Hashable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import node
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from quadpend_train.common import provenance
from quadpend_train.common.bundle import times, write_bundle
from quadpend_train.common.interruption import SIGNALS
from quadpend_train.common.processes import MOST_ATTEMPTS, answer, killed, read_answer
from quadpend_train.common.text import brief

Name = TypeVar("Name", bound=Hashable)
_ADDRESS = re.compile(r"auto|local|(ray://)?[\w.-]+:\d+")
_OPTIONS = {"log_to_driver": False, "logging_level": "ERROR", "ignore_reinit_error": True}
_LOCAL_OPTIONS = {"include_dashboard": False, "object_store_memory": 500_000_000}
_CONNECT_SECONDS = 10.0
_CALLS_OF_A_CORE = 4  # calls that are submitted at once, for each core of the cluster
_VARIABLES = {
    "RAY_USAGE_STATS_ENABLED": "0",  # Ray sends nothing about this machine
    "RAY_OVERRIDE_RUNTIME_ENV_DEFAULT_EXCLUDES": "",  # it would leave out caches of numba
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # the future default, which Ray warns about
}
_LOCAL_VARIABLES = {"RAY_worker_niceness": "0"}  # as the processes of this machine
_session: tuple[str, str] | None = None  # address, and hash of the bundle, of the open connection


class VersionError(ValueError):
    """A worker has packages of other versions."""


class RayExecutor:
    """An executor, see `quadpend_train.common.executors.Executor`.

    Args:
        address: ``auto`` (the cluster of this machine), ``local`` (start one on this machine), ``ray://HOST:PORT``, or
            ``HOST:PORT``. A program that has called `ray.init` itself keeps its connection.

    Raises:
        ModuleNotFoundError: If Ray is not installed.
        ValueError: If `address` is none of these.
    """

    def __init__(self, address: str) -> None:
        if not _ADDRESS.fullmatch(address):
            raise ValueError(f"cluster must be auto, local, ray://HOST:PORT or HOST:PORT, not {address!r}")
        self.address = address
        self.variables = _VARIABLES | (_LOCAL_VARIABLES if address == "local" else {})
        with _environment(self.variables):
            import ray  # noqa: F401

    def __call__(self, calls: Mapping[Name, Callable[[], Any]]) -> Generator[tuple[Name, Any], None, None]:
        """Yield the names of calls with what they return or raise, as soon as they end.

        Raises:
            ValueError: If there is no such cluster, a file cannot be sent, or a worker is refused.
        """
        if not calls:
            return
        import ray
        from ray import cloudpickle  # also takes functions of a script

        with _environment(self.variables):
            modified = self._connect(calls)
        context = ray.put((modified, provenance.versions(), provenance.sender()))
        run = ray.remote(_task())
        waiting = list(calls)[::-1]
        running: dict[Any, Any] = {}
        try:
            while waiting or running:
                most = max(_CALLS_OF_A_CORE * ray.cluster_resources().get("CPU", 1.0), 1.0)
                while waiting and len(running) < most:
                    call = calls[name := waiting.pop()]
                    portable = getattr(call, "elsewhere", lambda call=call: call)()
                    options = {"num_cpus": getattr(call, "cpus", 1), "max_retries": MOST_ATTEMPTS - 1}
                    running[run.options(**options).remote(cloudpickle.dumps(portable), context)] = name
                ray.wait(list(running), num_returns=1)
                done, _ = ray.wait(list(running), num_returns=len(running), timeout=0)
                for reference in done:
                    yield running.pop(reference), _outcome(reference)
        finally:
            for reference in running:
                ray.cancel(reference, force=True)

    def _connect(self, calls: Mapping[Any, Callable[[], Any]]) -> dict[str, int]:
        """Connect to the cluster with the code and the files of calls; return `times` of the code."""
        import ray
        from ray.exceptions import RayError

        global _session
        files = {Path(file) for call in calls.values() for file in getattr(call, "files", tuple)()}
        with TemporaryDirectory() as temporary:
            folder = Path(temporary)
            digest, modified = write_bundle(folder, sorted(files)), times(folder)
            if not ray.is_initialized():
                _session = None
            elif _session not in (None, (self.address, digest)):
                ray.shutdown()
            if not ray.is_initialized():
                local = _LOCAL_OPTIONS if self.address == "local" else {}
                environment = {"working_dir": temporary}
                try:
                    _check_address(self.address)
                    with _unblocked_signals():
                        ray.init(self.address, runtime_env=environment, **_OPTIONS, **local)
                except (OSError, RuntimeError) as error:
                    raise ValueError(f"there is no Ray cluster at {self.address}: {brief(error)}") from error
                except RayError as error:
                    raise ValueError(f"the cluster does not take the code: {brief(error)}") from error
                _session = self.address, digest
        return modified


def _check_address(address: str) -> None:
    """Connect to a host and a port, for which Ray itself would wait for minutes.

    Raises:
        OSError: If there is no connection.
    """
    host, _, port = address.rpartition("/")[2].partition(":")
    if port:
        socket.create_connection((host, int(port)), _CONNECT_SECONDS).close()


def _task() -> Callable[[bytes, Any], bytes]:
    """Return the function that a worker executes. Ray sends its code, since it prepares the import of the packages."""

    def run(call: bytes, context: Any) -> bytes:
        modified, versions, sender = context
        for name, time in modified.items():  # numba compares them with those in its cache
            if os.path.exists(name) and os.stat(name).st_mtime_ns != time:
                os.utime(name, ns=(time, time))
        from quadpend_train.common.ray_executor import work

        return work(call, versions, sender)

    return run


def work(call: bytes, versions: Mapping[str, str], sender: Mapping[str, Any]) -> bytes:
    """Execute a pickled call in a worker, see `quadpend_train.common.processes.answer`.

    Args:
        call: The call.
        versions: Versions of the packages that the worker must have.
        sender: What the provenance of files says about the process that sent the call.
    """
    provenance.sent.update(sender)
    for name, expected in versions.items():
        if (found := _version(name)).partition("+")[0] != expected.partition("+")[0]:
            has = f"{name} {found}" if found else f"no {name}"
            return pickle.dumps((None, VersionError(f"the node {node()} has {has} instead of {expected}"), ""))
    return answer(call)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _outcome(reference: Any) -> Any:
    """Return what a call returned or raised.

    Raises:
        ValueError: If the worker is refused or cannot run the code.
    """
    import ray
    from ray.exceptions import NodeDiedError, ObjectLostError, OutOfMemoryError, RayError, WorkerCrashedError

    try:
        outcome = read_answer(ray.get(reference))
    except (WorkerCrashedError, NodeDiedError, ObjectLostError, OutOfMemoryError):
        return killed("give the calls more memory or larger nodes")
    except RayError as error:
        raise ValueError(
            f"a worker of the cluster cannot run the code: {brief(str(getattr(error, 'cause', None) or error))}"
        ) from error
    if isinstance(outcome, VersionError):
        raise ValueError(
            f"a worker of the cluster is refused: {brief(str(outcome))}: install the same versions"
        ) from outcome
    return outcome


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set the environment variables that have no value during the block."""
    new = {name: value for name, value in variables.items() if name not in os.environ}
    os.environ.update(new)
    try:
        yield
    finally:
        for name in new:
            os.environ.pop(name, None)


@contextmanager
def _unblocked_signals() -> Iterator[None]:
    """Let the processes of a local cluster inherit no blocked signals, with which Ray ends them.

    Afterwards this process has its own handlers again: Ray sets one.
    """
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    before = signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for number, handler in handlers.items():
            signal.signal(number, handler)
