"""Cached results are used again, unless something that determines them has changed or the file is damaged."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import ADRC
from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation import cache, jobs
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes
from quadpend_train.evaluation.jobs import Job, load_learner, run_jobs

BOTH = {"one": "adrc-paper", "two": "adrc-matched"}
SCENARIOS = {"calm": Scenario(duration=1.0), "storm": Scenario(wind="storm", duration=1.0)}


def assert_same(first: Comparison, second: Comparison) -> None:
    assert first.table.equals(second.table)
    for cell, error in first.errors.items():
        np.testing.assert_array_equal(error, second.errors[cell])


def test_a_repeated_comparison_runs_no_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = compare(BOTH, SCENARIOS, 4, cache_folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 4
    monkeypatch.setattr(jobs, "run_episodes", None)
    assert_same(first, compare(BOTH, SCENARIOS, 4, cache_folder=tmp_path))


def test_an_interrupted_comparison_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    completed: list[Scenario] = []

    def run_two(policies: Any, scenario: Scenario, *rest: Any) -> EpisodeResults:
        if len(completed) == 2:
            raise KeyboardInterrupt
        completed.append(scenario)
        return run_episodes(policies, scenario, *rest)

    monkeypatch.setattr(jobs, "run_episodes", run_two)
    with pytest.raises(KeyboardInterrupt):
        compare(BOTH, SCENARIOS, 3, cache_folder=tmp_path)
    completed.clear()
    resumed = compare(BOTH, SCENARIOS, 3, cache_folder=tmp_path)
    assert len(completed) == 2
    monkeypatch.undo()
    assert_same(resumed, compare(BOTH, SCENARIOS, 3))


def test_recompute_ignores_cached_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(BOTH, SCENARIOS, 2, cache_folder=tmp_path)
    calls = []
    monkeypatch.setattr(jobs, "run_episodes", lambda *rest: calls.append(rest) or run_episodes(*rest))
    compare(BOTH, SCENARIOS, 2, cache_folder=tmp_path, recompute=True)
    assert len(calls) == 4


@pytest.mark.parametrize("size", [0, 100])
def test_results_in_a_damaged_file_are_computed_again(tmp_path: Path, size: int) -> None:
    first = compare(BOTH, SCENARIOS, 2, cache_folder=tmp_path)
    path = sorted(tmp_path.iterdir())[0]
    path.write_bytes(path.read_bytes()[:size])
    with pytest.warns(UserWarning, match=f"{path.name} is damaged and its results are computed again"):
        assert_same(first, compare(BOTH, SCENARIOS, 2, cache_folder=tmp_path))
    assert_same(first, compare(BOTH, SCENARIOS, 2, cache_folder=tmp_path))


def test_everything_that_determines_a_result_is_in_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
    start: dict[str, Any] = {"state": {"position": np.zeros(3)}}
    job = Job(load_learner("adrc-paper"), Scenario(), 10, 0)
    several = [
        job,
        job._replace(learner=load_learner("adrc-matched")),
        job._replace(learner=load_learner("adrc-paper,adrc-matched")),
        job._replace(scenario=Scenario(wind="windy")),
        job._replace(scenario=Scenario(duration=5.0)),
        job._replace(episodes=11),
        job._replace(seed=1),
        job._replace(options=start),
        job._replace(options={"state": {"position": np.ones(3)}}),
    ]
    keys = [item.key() for item in several]
    assert job._replace(options=start).key() in keys
    monkeypatch.setattr(cache, "code_hash", lambda: "other")
    keys.append(job.key())
    assert len(set(keys)) == len(keys)


def test_results_of_own_policies_and_own_winds_are_not_cached(tmp_path: Path) -> None:
    compare({"mine": [ADRC()]}, SCENARIOS, 2, cache_folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_results_do_not_depend_on_the_number_of_processes(tmp_path: Path) -> None:
    alone = compare({**BOTH, "mine": [ADRC()]}, SCENARIOS, 6)
    assert_same(alone, compare({**BOTH, "mine": [ADRC()]}, SCENARIOS, 6, cache_folder=tmp_path, jobs=2))
    assert len(list(tmp_path.iterdir())) == 4


def test_starts_of_a_reset_are_used(tmp_path: Path) -> None:
    lying = {"state": {"direction": np.tile([1.0, 0.0, 0.0], (3, 1))}}
    job = Job(load_learner("adrc-paper"), replace(SCENARIOS["calm"], duration=2.0), 3, 0)
    results = run_jobs({"plain": job, "lying": job._replace(options=lying)}, tmp_path)
    assert results["plain"].survived.all()
    assert not results["lying"].survived.any()


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
    tables = {"comparison.json", "comparison.csv", "comparison.md", "episodes.csv"}
    assert set(written[0]) == {"report.html", "comparison.png", *tables}
    assert b'<section id="replay">' in written[0]["report.html"]
