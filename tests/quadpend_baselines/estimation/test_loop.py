"""The known part of the loop acts as the actuators of the environment."""

from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from quadpend_baselines.estimation.loop import Loop, act
from quadpend_gym import Simulation
from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.streams import Streams

SIMULATION = Simulation()
ACTIONS = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3, 4)).astype(np.float32)


def test_loop_acts_as_the_actuators_in_any_order() -> None:
    actuators: list[Any] = [MotorLag(0.03), ActionDelay(2), MotorLag(0.02), ActionDelay(1)]
    streams = Streams(np.zeros(3, np.uint64))
    memories = [np.zeros((3, model.memory_size), order="F") for model in actuators]
    loop = Loop.of((), actuators)
    known, acting = np.zeros((24, 3)), np.empty((4, 1))
    for step, action in enumerate(ACTIONS):
        expected = np.asfortranarray(action, np.float64)
        for model, memory in zip(actuators, memories, strict=True):
            model.act(expected, memory, np.full(3, step), SIMULATION, streams)
        for row in range(3):
            acting[:, 0] = action[row]
            act(acting, loop.steps, loop.numbers(SIMULATION.period), known, 0, row)
            assert_allclose(acting[:, 0], expected[row], atol=1e-6)
