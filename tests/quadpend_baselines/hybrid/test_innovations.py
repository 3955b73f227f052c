"""Filtered innovations as inputs of a network."""

import numpy as np

from quadpend_baselines.estimation.estimate import INNOVATION, RIGID_PART
from quadpend_baselines.hybrid import EstimateOnly
from quadpend_baselines.hybrid.innovations import INNOVATIONS_SIZE
from tests.helpers.envs import make_vec

SCALE = 1e-3


def test_the_filters_follow_the_innovations_from_zero_and_begin_anew() -> None:
    env, hybrid, memory = make_vec(2, wind="windy"), EstimateOnly("flatness", innovations=True), None
    observation, last = env.reset(seed=0)[0], np.zeros((2, 3, 8))
    for step in range(40):
        started = np.array([step == 0, step in (0, 30)])
        seen, memory = hybrid.observe(observation, memory, started)
        now, filtered = seen[:, -INNOVATIONS_SIZE:-24], seen[:, -24:].reshape(2, 3, 8)
        innovation = memory.controller.estimate.array[:, INNOVATION:RIGID_PART]
        np.testing.assert_allclose(now[:, 2], innovation[:, 2] / SCALE, rtol=1e-6)
        np.testing.assert_allclose(now[:, 5:], innovation[:, 6:9] / SCALE, rtol=1e-6)
        last[started] = 0.0
        shares = (1.0 - np.exp(-0.01 / np.array([0.02, 0.06, 0.2])))[:, np.newaxis]
        last = last + shares * (now[:, np.newaxis] - last)
        np.testing.assert_allclose(filtered, last, rtol=1e-4, atol=1e-5)
        action, memory = hybrid.act(*hybrid.base_action(memory))
        observation, *_ = env.step(action)
    assert np.abs(last).max() > 0.01
