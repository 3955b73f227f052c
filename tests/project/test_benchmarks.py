"""The benchmarks run with small sizes."""

import json
from pathlib import Path

import pytest

from benchmarks import golden, golden_cases, speed
from quadpend_baselines import CONTROLLERS
from quadpend_train.policies.loading import shipped_policies


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "NUM_ENVS", (1, 4))
    monkeypatch.setattr(speed, "_SECONDS", 1e-4)
    monkeypatch.setattr(speed, "_ROUNDS", 1)


def test_speed_writes_a_rate_for_every_environment(
    brief: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speed, "measure_start", lambda: {"import": 0.1})
    monkeypatch.setattr(speed, "measure_training", lambda: {"quadpend": 2.0, "free": 3.0})
    monkeypatch.setattr("sys.argv", ["speed", "--out", str(tmp_path / "bench.json")])
    speed.main()
    data = json.loads((tmp_path / "bench.json").read_text())
    assert all(rate > 0 for rate in data["steps_per_second"].values())
    assert {
        "single / CartPole-v1",
        "num_envs=4 / CartPole-v1's",
        "num_envs=4, hummingbird / paper",
        "MlpPolicy.predict / PPO.predict, one observation",
    } <= set(data["ratios"])


def test_golden_hashes_are_repeatable_and_a_different_hash_is_reported(tmp_path: Path) -> None:
    names = {
        "environments": "QuadPendulumHover-v0, everything, single",
        "episodes": "lqr, windy",
        "trainings": "ppo with gSDE",
    }

    def hashes() -> dict[str, str]:
        parts = [golden.compute(f"{part}: {only}") for part, only in names.items()]
        return {name: value for part in parts for name, value in part.items()}

    first = hashes()
    assert [*first] == [f"{part}: {name}" for part, name in names.items()]
    assert golden.check(tmp_path / "golden.json", first) == []
    assert golden.check(tmp_path / "golden.json", hashes()) == []
    changed = {**first, "episodes: lqr, windy": "another"}
    assert golden.check(tmp_path / "golden.json", changed) == ["episodes: lqr, windy"]


def test_golden_hashes_cover_every_controller_and_shipped_policy() -> None:
    assert golden_cases.FLIGHTS.keys() == {*CONTROLLERS, *shipped_policies()}
