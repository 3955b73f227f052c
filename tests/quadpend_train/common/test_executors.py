"""A call that fails does not stop the others, and is named when they have ended."""

import shutil
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.common.bundle import times, write_bundle
from quadpend_train.common.executors import CallsFailedError, FolderCall, executor, successes
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.files import policy_files, scenario_files
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.policies.mlp_policy import SHIPPED
from tests.helpers.own_code import write_module
from tests.quadpend_train.common.test_processes import refuse, square

BRIEF = Scenario(duration=0.2)
FAILING = """
from quadpend_baselines import controller
class Failing:
    fingerprint = "1"
    def __init__(self): self.steps, self.policy = 0, controller("lqr")
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.steps += 1
        if self.steps > 10:
            raise KeyError("no gain")
        return self.policy.predict(observation, state, episode_start, deterministic)
def make(): return Failing()
"""


@pytest.mark.parametrize("processes", [1, 2])
def test_a_failing_policy_is_named_and_the_other_results_are_cached(
    processes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = write_module(tmp_path, monkeypatch, FAILING)
    policies = {"mine": f"{module}:make", "flatness": "flatness", "lqr": "lqr"}
    jobs = {("calm", name): Job(policy, BRIEF, 2, 0) for name, policy in policies.items()}
    with pytest.raises(CallsFailedError) as raised:
        run_jobs(jobs, tmp_path / "cache", processes=processes)
    first, second = str(raised.value).splitlines()
    assert first == "1 of 3 jobs failed; the results of the others are cached:"
    assert second == f"  calm, mine: KeyError: 'no gain' ({module}.py, line 9)"
    assert len(list((tmp_path / "cache").iterdir())) == 2


def test_a_command_with_a_failing_policy_ends_with_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = write_module(tmp_path, monkeypatch, FAILING)
    with pytest.raises(SystemExit) as ended:
        main(["compare", f"mine={module}:make", "lqr", "--scenarios", '{"duration": 0.2}', "--episodes", "2"])
    assert ended.value.code == 1
    assert "mine: KeyError: 'no gain'" in capsys.readouterr().err
    assert len(list((tmp_path / cache.FOLDER).iterdir())) == 1


def test_results_of_calls_arrive_before_the_failures_are_reported() -> None:
    calls: dict[Any, Any] = {("a", 1): partial(refuse, 1), 2: partial(square, 2), 3: partial(refuse, 3)}
    found = successes(executor()(calls), "trial", "are kept")
    assert next(found) == (2, 4)
    with pytest.raises(
        CallsFailedError, match="2 of 3 trials failed; the results of the others are kept:\n  a, 1: Val"
    ):
        next(found)


def fill(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    count = int((folder / "count").read_text()) if (folder / "count").exists() else 0
    (folder / "count").write_text(str(count + 1))


def test_a_folder_is_filled_here_or_elsewhere(tmp_path: Path) -> None:
    call = FolderCall(fill, tmp_path / "run")
    assert call() == {}
    files = call.elsewhere()()
    assert files == {"count": b"2"}
    assert (tmp_path / "run/count").read_text() == "1"
    call.keep(files)
    assert (tmp_path / "run/count").read_text() == "2"
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["count"]


@pytest.mark.parametrize("folder", ["memory://bucket/results", "file"])
def test_a_cache_may_be_a_url(folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = f"file://{tmp_path}/new/cache" if folder == "file" else folder
    cache.check_folder(folder)
    jobs = {name: Job(name, BRIEF, 2, 0) for name in ("flatness", "lqr")}
    first = run_jobs(jobs, folder)
    monkeypatch.setattr("quadpend_train.evaluation.jobs.run_episodes", None)
    for name, results in run_jobs(jobs, folder).items():
        assert [array.tobytes() for array in results] == [array.tobytes() for array in first[name]]
    local, remote = tmp_path / "local", cache._remote(folder, "name")
    cache.save(local, "name", first["lqr"])
    cache.save(folder, "name", first["lqr"])
    assert remote is not None
    assert len(remote[0].cat_file(remote[1])) == len((local / "name.npz").read_bytes())
    remote[0].pipe_file(remote[1], b"nonsense")
    with pytest.warns(UserWarning, match="damaged and its results are computed again"):
        assert cache.load(folder, "name", BRIEF.steps) is None


@pytest.mark.parametrize("folder", ["nix://bucket/cache", "file:///proc/nix"])
def test_a_wrong_cache_is_refused(folder: str) -> None:
    with pytest.raises(ValueError, match=r"cache must be a folder .*, not (nix://bucket/cache|file:///proc/nix)"):
        cache.check_folder(folder)


def test_a_bundle_has_the_code_and_the_files_under_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_module(tmp_path, monkeypatch, FAILING)
    shutil.copytree(SHIPPED, tmp_path / "runs", ignore=lambda _, names: [n for n in names if n != "apg-0.npz"])
    (tmp_path / "vehicle.toml").write_text("name = 'x'")
    (tmp_path / "scene.toml").write_text("duration = 0.2")
    files = [*policy_files(f"flatness,apg-1,{module}:make,runs/apg-0.npz"), *scenario_files(["calm", "scene.toml"])]
    assert files == [Path("runs/apg-0.npz"), Path("scene.toml")]
    bundle, other = tmp_path / "bundle", tmp_path / "other"
    bundle.mkdir()
    other.mkdir()
    digest = write_bundle(bundle, files)
    assert (bundle / "runs/apg-0.npz").read_bytes() == (SHIPPED / "apg-0.npz").read_bytes()
    assert {f"{module}.py", "quadpend_gym", "quadpend_baselines", "quadpend_train", "tests"} <= {
        path.name for path in bundle.iterdir()
    }
    assert "quadpend_train/common/bundle.py" in times(bundle)
    assert write_bundle(other, files) == digest
    (tmp_path / "scene.toml").write_text("duration = 0.3")
    shutil.rmtree(other)
    other.mkdir()
    assert write_bundle(other, files) != digest


def _rewrite(folder: Path) -> None:
    (folder / "checkpoint").unlink()
    (folder / "events").mkdir()
    (folder / "events/log").write_text("log")
    (folder / "policy").write_text("policy")


def test_folder_becomes_that_of_the_other_machine(tmp_path: Path) -> None:
    """Files in it, files that were deleted there, and files of subfolders."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "settings").write_text("settings")
    (folder / "checkpoint").write_text("checkpoint")
    (folder / ".lock").write_text("")
    call = FolderCall(_rewrite, folder)
    files = call.elsewhere()()
    assert list(files)[-1] == "policy"
    call.keep(files)
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert names == {"settings", "events/log", "policy", ".lock"}
