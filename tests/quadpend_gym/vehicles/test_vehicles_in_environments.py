"""The thrust of a vehicle's rotors reaches the pictures."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.testing import assert_allclose

from quadpend_gym.vehicles import VEHICLES

ID = "quadpend_gym:QuadPendulum-v0"


def test_the_picture_shows_the_thrust_that_the_rotors_have_reached() -> None:
    env: Any = gym.make(ID, vehicle="hummingbird", interface="rotors", render_mode="rgb_array")
    env.reset(seed=0)
    most = 4.0 * 3.8 / VEHICLES["hummingbird"].weight
    assert_allclose(env.unwrapped.recorder.snapshot().thrust, 1.0, atol=1e-9)
    env.step(np.ones(4, np.float32))
    share = 1.0 - np.exp(-0.01 / 0.015)  # the lag after a control period
    assert_allclose(env.unwrapped.recorder.snapshot().thrust, 1.0 + share * (most - 1.0), rtol=0.02)
