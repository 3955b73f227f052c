"""The benchmark runs, briefly but for real."""

import json
from pathlib import Path

import pytest

from benchmarks import speed


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "ROWS", (1, 4))
    monkeypatch.setattr(speed, "_SECONDS", 1e-4)
    monkeypatch.setattr(speed, "_TURNS", 1)


def test_every_environment_is_measured_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "measure_start", lambda: {"import": 0.1})
    monkeypatch.setattr(speed, "measure_training", lambda: {"ours": 2.0, "free": 3.0})
    speed.main(tmp_path / "bench.json")
    data = json.loads((tmp_path / "bench.json").read_text())
    assert all(rate > 0 for rate in data["steps_per_second"].values())
    assert {
        "single / CartPole-v1",
        "4 rows / CartPole-v1's",
        "LearnedPolicy.predict / PPO.predict, one observation",
    } <= set(data["ratios"])


def test_ppo_is_measured_on_ours_and_on_a_free_environment() -> None:
    ours, free = speed.measure_training(steps=1, turns=1).values()
    assert ours > 0
    assert free > 0
