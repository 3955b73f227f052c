"""What has been flown is not flown again, unless something has changed or broken."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import ADRC
from quadpend_train.cli.main import main
from quadpend_train.evaluation import cache, jobs
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes
from quadpend_train.policies.loading import policy_fingerprint
from quadpend_train.scenarios import Scenario, find_scenario

BOTH = {"one": "adrc-paper", "two": "adrc-matched"}


def assert_same(first: Comparison, second: Comparison) -> None:
    assert list(first.flights) == list(second.flights)
    for cell, flights in first.flights.items():
        for mine, its in zip(flights, second.flights[cell], strict=True):
            np.testing.assert_array_equal(mine, its)
    assert first.as_data() == second.as_data()


def test_a_second_run_flies_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = compare(BOTH, ["calm", "storm"], 4, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 4
    monkeypatch.setattr(jobs, "flat_trajectory", None)
    assert_same(first, compare(BOTH, ["calm", "storm"], 4, folder=tmp_path))
    assert_same(first, compare({"one": "adrc-paper", "two": "adrc-matched"}, ["calm", "storm"], 4, folder=tmp_path))


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[str] = []

    def fly_two(policies: Any, scenario: Scenario, *rest: Any) -> EpisodeResults:
        if len(flown) == 2:
            raise KeyboardInterrupt
        flown.append(scenario.description)
        return run_episodes(policies, scenario, *rest)

    monkeypatch.setattr(jobs, "flat_trajectory", fly_two)
    with pytest.raises(KeyboardInterrupt):
        compare(BOTH, ["calm", "windy"], 3, folder=tmp_path)
    flown.clear()
    resumed = compare(BOTH, ["calm", "windy"], 3, folder=tmp_path)
    assert len(flown) == 2
    monkeypatch.undo()
    assert_same(resumed, compare(BOTH, ["calm", "windy"], 3))


def test_fresh_flies_all_of_them_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(BOTH, ["calm"], 2, folder=tmp_path)
    flown = []
    monkeypatch.setattr(jobs, "flat_trajectory", lambda *rest: flown.append(rest) or run_episodes(*rest))
    compare(BOTH, ["calm"], 2, folder=tmp_path, fresh=True)
    assert len(flown) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nonsense", b"nonsense"])
def test_a_damaged_file_is_flown_again(tmp_path: Path, damage: bytes) -> None:
    first = compare(BOTH, ["calm"], 2, folder=tmp_path)
    path = sorted(tmp_path.iterdir())[0]
    whole = path.read_bytes()
    path.write_bytes(damage)
    with pytest.warns(UserWarning, match=f"{path.name} is damaged and will be flown again"):
        assert_same(first, compare(BOTH, ["calm"], 2, folder=tmp_path))
    assert len(path.read_bytes()) == len(whole)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.warns(UserWarning, match="is damaged"):
        assert_same(first, compare(BOTH, ["calm"], 2, folder=tmp_path))


def test_whatever_decides_a_flight_is_in_its_key(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_models_identity_is_its_file(tmp_path: Path) -> None:
    (tmp_path / "policy.npz").write_bytes(b"weights")
    (tmp_path / "copy.npz").write_bytes(b"weights")
    first = policy_fingerprint(str(tmp_path))
    assert first == policy_fingerprint(str(tmp_path / "copy.npz"))
    (tmp_path / "policy.npz").write_bytes(b"other weights")
    assert policy_fingerprint(str(tmp_path)) != first
    with pytest.raises(ValueError, match="there is no policy 'nix'"):
        policy_fingerprint("nix")


def test_policies_without_a_name_are_not_kept(tmp_path: Path) -> None:
    compare({"mine": [ADRC()]}, ["calm"], 2, folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_results_are_the_same_whatever_the_number_of_jobs(tmp_path: Path) -> None:
    alone = compare({**BOTH, "mine": [ADRC()]}, ["calm", "storm"], 6)
    assert_same(alone, compare({**BOTH, "mine": [ADRC()]}, ["calm", "storm"], 6, folder=tmp_path, jobs=2))
    assert len(list(tmp_path.iterdir())) == 4


def test_results_are_the_same_byte_for_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Flown, flown again, and taken from the store."""
    monkeypatch.setattr("sys.argv", ["quadpend", "evaluate"])
    written = []
    for _ in range(3):
        options = ["--store", str(tmp_path / "store"), *(["--fresh"] if len(written) == 1 else [])]
        main(["evaluate", "--scenarios", "calm", "gusts", "--episodes", "3", "--out", str(tmp_path / "out"), *options])
        files = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
        files["report.html"] = re.sub(rb"\d{4}-\d\d-\d\d", b"", files["report.html"])  # but for the date
        written.append(files)
    assert written[0] == written[1] == written[2]
    assert set(written[0]) == {"comparison.json", "comparison.csv", "comparison.md", "comparison.png", "report.html"}
    assert json.loads(written[0]["comparison.json"])["scenario_hashes"].keys() == {"calm", "gusts"}


def test_a_model_that_changes_while_it_flies_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = iter(["before", "after"])
    monkeypatch.setattr(jobs.Job, "key", lambda self: next(keys))
    cell = {"calm": jobs.Job("adrc-paper", find_scenario("calm"), 1, 0)}
    with pytest.raises(ValueError, match="adrc-paper has changed while it was flown"):
        jobs.run_jobs(cell, tmp_path)
    assert list(tmp_path.iterdir()) == []
