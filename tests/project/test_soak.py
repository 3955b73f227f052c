"""The soak and its damaged files run with small numbers and find nothing; a planted fault is found."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import fuzz, soak
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv


@pytest.mark.parametrize("name", fuzz.TARGETS)
def test_damaged_files_are_refused_or_read_as_they_were(name: str, tmp_path: Path) -> None:
    assert fuzz.fuzz(name, range(60), tmp_path) == []


def test_random_steps_find_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "STEPS_OF_A_CONFIGURATION", 20)
    outcome = soak.random_steps(0, 40_000)
    assert outcome.findings == []
    assert outcome.done >= 40_000
    counts = Counter(dict(outcome.counts))
    assert counts["usual settings"] + counts["extreme settings"] > 3
    assert counts["terminations"] > 0


@pytest.mark.parametrize("part", [soak.resets, soak.environments])
def test_resets_and_environments_find_nothing(part: Any) -> None:
    assert part(1, 20).findings == []


def test_a_planted_fault_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def step(env: QuadPendulumVectorEnv, actions: Any) -> Any:
        return (*planted, np.zeros(env.num_envs, np.bool_), np.zeros(env.num_envs, np.bool_), {})

    monkeypatch.setattr(soak, "random_env", lambda seed, counts: QuadPendulumVectorEnv(3))
    monkeypatch.setattr(QuadPendulumVectorEnv, "step", step)
    planted = np.full((3, 36), np.nan, np.float32), np.ones(3)
    assert "not finite" in soak.fly(0, 10, Counter())[1]
    planted = np.zeros((3, 36), np.float32), np.full(3, 1.1)
    assert "a reward is not in [0, 1]" in soak.fly(0, 10, Counter())[1]


def test_grown_memory_is_a_finding() -> None:
    assert soak._grown(9.0, 1000) == []
    assert soak._grown(11.0, 1000) == ["memory grew by 11 MB in 1,000 steps"]
    assert soak._grown(60.0, 100_000_000) == []
