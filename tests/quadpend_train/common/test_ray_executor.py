"""A study on a Ray cluster gives the same bytes as on this machine, also if workers and nodes are killed."""

import os
import shutil
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from quadpend_gym.scenarios import find_scenario
from quadpend_train.cli.main import main
from quadpend_train.common import provenance
from quadpend_train.common.executors import CallsFailedError, FolderCall, executor, successes
from quadpend_train.evaluation import jobs
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.policies.mlp_policy import SHIPPED
from tests.helpers.own_code import write_module
from tests.quadpend_train.common.test_processes import kill_itself, kill_itself_once, refuse, square

NEEDS_RAY = "needs Ray: make check-extras, or pip install 'quadpend-gym[cluster]'"
pytestmark = [pytest.mark.extras, pytest.mark.filterwarnings("ignore")]  # warnings of Ray
OWN = """
from quadpend_baselines import controller
from quadpend_gym import StillAir
def make(simulation): return controller("lqr", simulation)
def wind(): return StillAir()
"""


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes with one core each; the first is that of this process.

    Each has a folder of its own for the code. In a folder that nodes share, a node that starts deletes the code and
    unpacks it again while workers of the other nodes import it.
    """
    pytest.importorskip("ray", reason=NEEDS_RAY)
    from ray.cluster_utils import Cluster

    soon = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500, "health_check_failure_threshold": 4}
    options = {"num_cpus": 1, "object_store_memory": 100_000_000, "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args={**options, "_system_config": soon})
    made.add_node(**options, runtime_env_dir_name="runtime_resources_1")
    yield made
    import ray

    ray.shutdown()
    made.shutdown()


@pytest.fixture
def cells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[tuple[str, str], Job]:
    """Four policies in four scenarios, among them own code and a file in the working directory."""
    module = write_module(tmp_path, monkeypatch, OWN)
    shutil.copy(SHIPPED / "ppo-gain-scheduling-0.npz", tmp_path / "mine.npz")
    brief = ["calm", "windy", "noisy", f"{module}:wind"]
    scenarios = {name: find_scenario(name) for name in brief}
    return {
        (name, policy): Job(policy, scenario, 2, 7, None)
        for name, scenario in scenarios.items()
        for policy in ("flatness", "adrc-paper", "mine.npz", f"{module}:make")
    }


def brief(cells: dict[Any, Job], seconds: float) -> dict[Any, Job]:
    from dataclasses import replace

    return {name: job._replace(scenario=replace(job.scenario, duration=seconds)) for name, job in cells.items()}


def contents(results: dict[Any, Any]) -> dict[Any, list[bytes]]:
    return {name: [array.tobytes() for array in arrays] for name, arrays in results.items()}


def test_a_cluster_of_two_nodes_gives_the_bytes_of_this_machine_and_keeps_them(
    cluster: Any, cells: dict[Any, Job], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, ray = brief(cells, 0.5), executor(cluster=cluster.address)
    first = contents(run_jobs(study, tmp_path / "cache", processes=ray))
    assert first == contents(run_jobs(study))
    assert len(list((tmp_path / "cache").iterdir())) == 9  # own code has no fingerprint
    known = {name: job for name, job in study.items() if job.cache_key()}
    monkeypatch.setattr(jobs, "run_episodes", None)
    monkeypatch.setattr(ray, "address", "nowhere:1")
    assert contents(run_jobs(known, tmp_path / "cache", processes=ray)) == {name: first[name] for name in known}


def test_a_killed_node_changes_nothing(cluster: Any, cells: dict[Any, Job]) -> None:
    study = brief(cells, 2.0)
    node = cluster.add_node(num_cpus=1, object_store_memory=100_000_000, runtime_env_dir_name="runtime_resources_2")
    calls = successes(executor(cluster=cluster.address)(study))
    results = dict([next(calls), next(calls)])
    for process in node.all_processes["raylet"]:
        os.kill(process.process.pid, signal.SIGKILL)
    assert contents({**results, **dict(calls)}) == contents(run_jobs(study, processes=2))


def test_a_call_whose_worker_is_killed_is_computed_again(cluster: Any, tmp_path: Path) -> None:
    calls: dict[str, Any] = {
        "once": partial(kill_itself_once, tmp_path / "killed"),
        "always": partial(kill_itself, signal.SIGKILL),
        "odd": partial(refuse, 3),
        "even": partial(square, 4),
    }
    found: dict[str, Any] = dict(executor(cluster=cluster.address)(calls))
    assert (found["once"], found["even"]) == ("computed again", 16)
    assert str(found["always"]).startswith("its processes were killed 3 times")
    assert str(found["odd"]) == "number must be even, not 3"
    assert "in refuse" in str(found["odd"].__cause__)


def where(folder: Path) -> None:
    import quadpend_gym

    folder.mkdir(exist_ok=True)
    (folder / "where.txt").write_text(f"{quadpend_gym.__file__} {os.getcwd()} {provenance.provenance()['command']}")


def test_the_code_comes_from_the_runtime_environment_and_files_come_back(cluster: Any, tmp_path: Path) -> None:
    call = FolderCall(where, tmp_path / "run")
    ((_, files),) = executor(cluster=cluster.address)({0: call})
    call.keep(files)
    package, folder, command = (tmp_path / "run/where.txt").read_text().split(" ", 2)
    assert "runtime_resources" in package
    assert Path(package).is_relative_to(folder)
    assert command == str(provenance.provenance()["command"])


def test_a_worker_with_other_versions_is_refused(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {**provenance.versions(), "numpy": "0.1"}
    monkeypatch.setattr(provenance, "versions", lambda: versions)
    with pytest.raises(ValueError, match=r"a worker of the cluster is refused: .* has numpy .* instead of 0\.1"):
        list(executor(cluster=cluster.address)({0: partial(square, 2)}))


def test_a_file_outside_the_working_directory_is_refused(cluster: Any, tmp_path: Path) -> None:
    shutil.copy(SHIPPED / "ppo-gain-scheduling-0.npz", tmp_path / "mine.npz")
    job = Job(str(tmp_path / "mine.npz"), find_scenario("calm"), 1, 0)
    with pytest.raises(ValueError, match="takes files in the working directory by their relative paths, not /"):
        run_jobs({0: job}, processes=executor(cluster=cluster.address))


def test_a_missing_cluster_is_named() -> None:
    pytest.importorskip("ray", reason=NEEDS_RAY)
    import ray

    ray.shutdown()
    with pytest.raises(ValueError, match="there is no Ray cluster at localhost:1"):
        list(executor(cluster="localhost:1")({0: partial(square, 2)}))
    with pytest.raises(ValueError, match="cluster must be auto, local, ray://HOST:PORT or HOST:PORT, not 'x'"):
        executor(cluster="x")


@pytest.mark.parametrize("command", ["evaluate", "bound", "vehicles", "ablate", "train --seeds 0-1"])
def test_the_missing_package_is_named(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SystemExit):
        main([*command.split(), "--cluster", "local"])
    assert "pip install 'quadpend-gym[cluster]'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*command.split(), "--cluster", "local", "--jobs", "2"])
    assert "give no --jobs with --cluster" in capsys.readouterr().err


def test_a_failure_on_a_cluster_has_a_name(cluster: Any) -> None:
    calls = {("windy", "mine"): partial(refuse, 3)}
    with pytest.raises(
        CallsFailedError, match=r"1 of 1 jobs failed:\n  windy, mine: ValueError: number must.*test_proc"
    ):
        list(successes(executor(cluster=cluster.address)(calls)))
