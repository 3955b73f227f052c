"""Cached results are used again, unless something that determines them has changed."""

import re
from pathlib import Path

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation import jobs
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.jobs import Job
from quadpend_train.policies.loading import load_policies

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


def test_a_damaged_result_is_computed_again(tmp_path: Path) -> None:
    first = compare(BOTH, SCENARIOS, 4, cache_folder=tmp_path)
    *files, last = tmp_path.iterdir()
    for path, data in zip(files, (b"", b"?" * 99, b"PK\x03\x04"), strict=True):
        path.write_bytes(data)
    last.write_bytes(last.read_bytes()[:-9])
    assert_same(first, compare(BOTH, SCENARIOS, 4, cache_folder=tmp_path))
    for path, place in zip(files, (6, 8, 10), strict=True):  # version, flag of encryption, method of compression
        data = bytearray(path.read_bytes())
        data[data.index(b"PK\x01\x02") + place] = 99
        path.write_bytes(data)
    assert_same(first, compare(BOTH, SCENARIOS, 4, cache_folder=tmp_path))


def test_everything_that_determines_a_result_is_in_the_name_of_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = Job(load_policies("adrc-paper"), Scenario(), 10, 0)
    several = [
        job,
        job._replace(policies=load_policies("adrc-matched")),
        job._replace(policies=load_policies("adrc-paper,adrc-matched")),
        job._replace(scenario=Scenario(wind="windy")),
        job._replace(scenario=Scenario(duration=5.0)),
        job._replace(episodes=11),
        job._replace(seed=1),
        job._replace(known=Scenario()),
        job._replace(enough=3),
    ]
    keys = [item.file(tmp_path) for item in several]
    monkeypatch.setattr(jobs, "code_hash", lambda: "other")
    keys.append(job.file(tmp_path))
    assert len(set(keys)) == len(keys)


def test_results_do_not_depend_on_the_number_of_processes(tmp_path: Path) -> None:
    alone = compare({**BOTH, "mine": [controller("adrc-paper")]}, SCENARIOS, 6)
    assert_same(
        alone, compare({**BOTH, "mine": [controller("adrc-paper")]}, SCENARIOS, 6, cache_folder=tmp_path, jobs=2)
    )
    assert len(list(tmp_path.iterdir())) == 4


def test_the_files_of_results_are_the_same_byte_for_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Computed, computed again, and loaded from the cache."""
    monkeypatch.setattr("sys.argv", ["quadpend", "evaluate"])
    scenarios = ['calm={"duration": 1.0}', 'storm={"wind": "storm", "duration": 1.0}']
    written = []
    for store in ("a", "b", "b"):
        options = ["--cache", str(tmp_path / store)]
        main(["evaluate", "--scenarios", *scenarios, "--episodes", "3", "--out", str(tmp_path / "out"), *options])
        files = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
        files["report.html"] = re.sub(rb"\d{4}-\d\d-\d\d", b"", files["report.html"])  # without the date
        written.append(files)
    assert written[0] == written[1] == written[2]
    tables = {"comparison.csv", "comparison.md", "episodes.csv"}
    assert set(written[0]) == {"report.html", *tables}
