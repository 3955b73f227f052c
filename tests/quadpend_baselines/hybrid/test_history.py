"""Stacked observations and actions as inputs of a network: those of the wrapper that it was trained in."""

import numpy as np
import pytest

from quadpend_baselines.hybrid import HistoryOnly
from quadpend_gym.wrappers import VectorHistoryWrapper
from tests.helpers.envs import make_vec
from tests.helpers.wrappers import SHORT


@pytest.mark.parametrize(("observations", "actions"), [(3, 2), (1, 1), (4, 0)])
def test_the_inputs_are_the_observations_of_the_wrapper_across_episodes(observations: int, actions: int) -> None:
    options = {"wind": "windy", "autoreset_mode": "SameStep", **SHORT}
    plain, hybrid = make_vec(3, **options), HistoryOnly(observations, actions)
    stacked = VectorHistoryWrapper(make_vec(3, **options), observations, actions)
    observation, expected = plain.reset(seed=1)[0], stacked.reset(seed=1)[0]
    memory, started, random, ends = None, np.ones(3, np.bool_), np.random.default_rng(0), 0
    for _ in range(70):
        seen, memory = hybrid.observe(observation, memory, started)
        np.testing.assert_array_equal(seen, expected)
        action, memory = hybrid.act(random.uniform(-0.2, 0.2, (3, 4)).astype(np.float32), memory)
        expected, *_ = stacked.step(action)
        observation, _, terminated, truncated, _ = plain.step(action)
        started = terminated | truncated
        ends += started.sum()
    assert ends >= 3
    with pytest.raises(ValueError, match="2 or more observations"):
        HistoryOnly(1, 0)
