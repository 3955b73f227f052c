"""Random settings, also extreme ones, fly: what is returned stays within its bounds, and the pole is rigid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.random_settings import random_scenario

STEPS = 20


@pytest.mark.filterwarnings("ignore:.*(the wind pushes with up to|the trajectory (needs|reaches))")
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rows=st.sampled_from((1, 7)))
def test_random_settings_fly(seed: int, rows: int) -> None:
    random = np.random.default_rng(seed)
    env = random_scenario(random).make_vec(rows)
    env.reset(seed=seed)
    for _ in range(STEPS):
        action = random.uniform(-1.0, 1.0, (rows, 4)).astype(np.float32)
        observation, reward, *_ = env.step(np.sign(action) if random.random() < 0.1 else action)
        assert np.isfinite(observation).all()
        assert env.observation_space.contains(observation)
        assert ((reward >= 0.0) & (reward <= 1.0)).all()
    direction, rate = env.unwrapped.state.direction, env.unwrapped.state.direction_rate  # type: ignore[attr-defined]
    np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0, rtol=1e-12)
    across = np.sum(direction * rate, axis=-1) / (1.0 + np.linalg.norm(rate, axis=-1))
    np.testing.assert_allclose(across, 0.0, atol=1e-12)
    env.close()
