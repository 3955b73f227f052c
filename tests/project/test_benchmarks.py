"""The benchmarks run with small sizes."""

import json
from pathlib import Path

import pytest

from benchmarks import golden, speed


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
    speed.run(tmp_path / "bench.json")
    data = json.loads((tmp_path / "bench.json").read_text())
    assert all(rate > 0 for rate in data["steps_per_second"].values())
    assert {
        "single / CartPole-v1",
        "num_envs=4 / CartPole-v1's",
        "num_envs=4, hummingbird / paper",
        "MlpPolicy.predict / PPO.predict, one observation",
    } <= set(data["ratios"])


def test_ppo_is_measured_on_quadpendulum_and_on_a_free_environment() -> None:
    quadpend, free = speed.measure_training(steps=1, rounds=1).values()
    assert quadpend > 0
    assert free > 0


def test_golden_hashes_are_repeatable_and_a_different_hash_is_reported(tmp_path: Path) -> None:
    def hashes() -> dict[str, str]:
        return {
            **dict(golden.environments(golden.ENV_IDS[:1], ["storm"], steps=20, num_envs=3)),
            **dict(golden.episodes(["lqr"], ["windy"], count=2)),
            **dict(golden.trainings(["ppo"])),
        }

    first = hashes()
    single = [value for name, value in first.items() if name.endswith("single")]
    assert len(set(single)) == len(single) == len(golden.STACKS)
    assert len(first) == 3 * len(golden.STACKS) + 2
    assert golden.check(tmp_path / "golden.json", first) == []
    assert golden.check(tmp_path / "golden.json", hashes()) == []
    assert golden.check(tmp_path / "golden.json", {**first, "ppo": "another"}) == ["ppo"]
