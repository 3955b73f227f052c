"""Random settings fly, and the soak finds planted faults."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import soak
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_random_settings_fly(seed: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soak, "ROWS", (1, 7))
        assert soak.found(lambda: soak.fly(seed, 20))[1] == []


def test_a_planted_fault_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def step(env: QuadPendulumVectorEnv, actions: Any) -> Any:
        rows = env.num_envs
        return np.full((rows, 36), np.nan, np.float32), np.ones(rows), np.zeros(rows, bool), np.zeros(rows, bool), {}

    monkeypatch.setattr(QuadPendulumVectorEnv, "step", step)
    assert "not finite" in soak.found(lambda: soak.fly(0, 10))[1][0]
    assert soak.grown(11.0, 1000) == ["memory grew by 11 MB in 1,000 steps"]
    assert soak.grown(60.0, 100_000_000) == []
