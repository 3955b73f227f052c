"""Cached results are used again, unless something that determines them has changed or the file is damaged."""

import errno
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import quadpend_baselines
import quadpend_gym
from quadpend_baselines import ADRC
from quadpend_gym.core.source_hash import source_hash
from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation import cache, jobs
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes
from quadpend_train.policies.loading import policy_fingerprint

BOTH = {"one": "adrc-paper", "two": "adrc-matched"}
CALM, STORM = {"calm": Scenario(duration=1.0)}, {"storm": Scenario(wind="storm", duration=1.0)}


def assert_same(first: Comparison, second: Comparison) -> None:
    assert list(first.results) == list(second.results)
    for cell, results in first.results.items():
        for array, other in zip(results, second.results[cell], strict=True):
            np.testing.assert_array_equal(array, other)
    assert first.as_data() == second.as_data()


def test_a_repeated_comparison_runs_no_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = compare(BOTH, CALM | STORM, 4, cache_folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 4
    monkeypatch.setattr(jobs, "run_episodes", None)
    assert_same(first, compare(BOTH, CALM | STORM, 4, cache_folder=tmp_path))
    assert_same(first, compare({"one": "adrc-paper", "two": "adrc-matched"}, CALM | STORM, 4, cache_folder=tmp_path))


def test_an_interrupted_comparison_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    completed: list[str] = []

    def run_two(policies: Any, scenario: Scenario, *rest: Any) -> EpisodeResults:
        if len(completed) == 2:
            raise KeyboardInterrupt
        completed.append(scenario.description)
        return run_episodes(policies, scenario, *rest)

    monkeypatch.setattr(jobs, "run_episodes", run_two)
    with pytest.raises(KeyboardInterrupt):
        compare(BOTH, CALM | STORM, 3, cache_folder=tmp_path)
    completed.clear()
    resumed = compare(BOTH, CALM | STORM, 3, cache_folder=tmp_path)
    assert len(completed) == 2
    monkeypatch.undo()
    assert_same(resumed, compare(BOTH, CALM | STORM, 3))


def test_fresh_ignores_cached_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(BOTH, CALM, 2, cache_folder=tmp_path)
    calls = []
    monkeypatch.setattr(jobs, "run_episodes", lambda *rest: calls.append(rest) or run_episodes(*rest))
    compare(BOTH, CALM, 2, cache_folder=tmp_path, recompute=True)
    assert len(calls) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nonsense", b"nonsense"])
def test_results_in_a_damaged_file_are_computed_again(tmp_path: Path, damage: bytes) -> None:
    first = compare(BOTH, CALM, 2, cache_folder=tmp_path)
    path = sorted(tmp_path.iterdir())[0]
    whole = path.read_bytes()
    path.write_bytes(damage)
    with pytest.warns(UserWarning, match=f"{path.name} is damaged and its results are computed again"):
        assert_same(first, compare(BOTH, CALM, 2, cache_folder=tmp_path))
    assert len(path.read_bytes()) == len(whole)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.warns(UserWarning, match="is damaged"):
        assert_same(first, compare(BOTH, CALM, 2, cache_folder=tmp_path))


def test_everything_that_determines_a_result_is_in_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
    paper, matched = policy_fingerprint("adrc-paper"), policy_fingerprint("adrc-matched")
    keys = [
        cache.key([paper], Scenario(), 10, 0),
        cache.key([matched], Scenario(), 10, 0),
        cache.key([paper, matched], Scenario(), 10, 0),
        cache.key([paper], Scenario(wind="windy"), 10, 0),
        cache.key([paper], Scenario(), 11, 0),
        cache.key([paper], Scenario(), 10, 1),
    ]
    monkeypatch.setattr(cache, "code_stamp", lambda: "other")
    keys.append(cache.key([paper], Scenario(), 10, 0))
    assert len(set(keys)) == len(keys)
    assert "horizontal_bandwidth=7.0" in paper


def test_the_code_stamp_covers_the_code_of_an_episode_and_no_pictures() -> None:
    sources = {path.as_posix() for path in cache.sources()}
    for ending in (
        "quadpend_gym/physics/kernel.py",
        "quadpend_gym/wind/turbulence.py",
        "quadpend_gym/wrappers/observation.py",
        "quadpend_baselines/gains.py",
        "quadpend_baselines/hybrid/wrappers.py",
        "quadpend_baselines/controllers/swing_up.csv",
        "quadpend_train/evaluation/episodes.py",
        "quadpend_train/policies/mlp_policy.py",
        "quadpend_gym/scenarios/scenario.py",
    ):
        assert sum(path.endswith(ending) for path in sources) == 1, ending
    assert not [path for path in sources if "/viewer/" in path or "/paper/" in path or "/reports/" in path]
    assert cache.code_stamp() == source_hash(cache.sources())


def test_the_sources_are_those_of_the_imported_packages() -> None:
    folders = [Path(str(package.__file__)).parent for package in (quadpend_gym, quadpend_baselines)]
    for folder in folders:
        assert any(path.is_relative_to(folder) for path in cache.sources())


def test_the_identity_of_a_model_is_the_hash_of_its_file(tmp_path: Path) -> None:
    (tmp_path / "policy.npz").write_bytes(b"weights")
    (tmp_path / "copy.npz").write_bytes(b"weights")
    first = policy_fingerprint(str(tmp_path))
    assert first == policy_fingerprint(str(tmp_path / "copy.npz"))
    (tmp_path / "policy.npz").write_bytes(b"other weights")
    assert policy_fingerprint(str(tmp_path)) != first
    with pytest.raises(ValueError, match="there is no policy 'nix'"):
        policy_fingerprint("nix")


def test_results_of_policies_without_a_name_are_not_cached(tmp_path: Path) -> None:
    compare({"mine": [ADRC()]}, CALM, 2, cache_folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_results_do_not_depend_on_the_number_of_processes(tmp_path: Path) -> None:
    alone = compare({**BOTH, "mine": [ADRC()]}, CALM | STORM, 6)
    assert_same(alone, compare({**BOTH, "mine": [ADRC()]}, CALM | STORM, 6, cache_folder=tmp_path, jobs=2))
    assert len(list(tmp_path.iterdir())) == 4


def test_the_files_of_results_are_the_same_byte_for_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Computed, computed again, and loaded from the cache."""
    monkeypatch.setattr("sys.argv", ["quadpend", "evaluate"])
    scenarios = ['calm={"duration": 1.0}', 'storm={"wind": "storm", "duration": 1.0}']
    written = []
    for _ in range(3):
        options = ["--cache", str(tmp_path / "store"), *(["--recompute"] if len(written) == 1 else [])]
        main(["evaluate", "--scenarios", *scenarios, "--episodes", "3", "--out", str(tmp_path / "out"), *options])
        files = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
        files["report.html"] = re.sub(rb"\d{4}-\d\d-\d\d", b"", files["report.html"])  # without the date
        written.append(files)
    assert written[0] == written[1] == written[2]
    assert set(written[0]) == {"comparison.json", "comparison.csv", "comparison.md", "comparison.png", "report.html"}
    assert json.loads(written[0]["comparison.json"])["scenario_hashes"].keys() == {"calm", "storm"}


def test_results_of_a_model_that_changes_meanwhile_are_not_cached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = iter(["before", "after"])
    monkeypatch.setattr(jobs.Job, "cache_key", lambda self: next(keys))
    job = {"calm": jobs.Job("adrc-paper", Scenario(duration=0.5), 1, 0)}
    with pytest.raises(ValueError, match="adrc-paper has changed during its evaluation"):
        jobs.run_jobs(job, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_nothing_in_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writing stops in the middle of a file: the temporary file is deleted, and the old file stays."""
    results = run_episodes([ADRC()], Scenario(duration=0.05), 1)
    cache.save(tmp_path, "old", results)
    kept, save = (tmp_path / "old.npz").read_bytes(), np.savez

    def write_half(file: Any, **arrays: Any) -> None:
        save(file, survived=arrays["survived"])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", write_half)
        for name in ("old", "new"):
            with pytest.raises(OSError, match="No space left"):
                cache.save(tmp_path, name, results)
    assert [path.name for path in tmp_path.iterdir()] == ["old.npz"]
    assert (tmp_path / "old.npz").read_bytes() == kept
