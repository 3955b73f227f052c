"""The known part of the loop: it acts as the actuators of the environment, and the lag is compensated."""

from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.estimation.loop import FASTEST_LAG, Loop, act, compensate
from quadpend_gym import Simulation
from quadpend_gym.actuators import ActionDelay, MotorLag, RateLimit
from quadpend_gym.core.streams import Streams

SIMULATION = Simulation()
ACTIONS = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3, 4)).astype(np.float32)


def test_loop_acts_as_the_actuators_in_any_order() -> None:
    actuators: list[Any] = [MotorLag(0.03), ActionDelay(2), RateLimit(30.0), ActionDelay(1)]
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


def test_slow_lag_is_compensated_to_the_fastest_one() -> None:
    loop, fast = Loop(actuators=(MotorLag(0.06),)), MotorLag(FASTEST_LAG)
    memory, expected, streams = np.zeros((4, 1)), np.zeros((1, 4), order="F"), Streams(np.zeros(1, np.uint64))
    numbers = loop.numbers(SIMULATION.period)
    for wanted in 0.1 * ACTIONS[:, :1]:
        sent = wanted.T.astype(np.float64)
        compensate(sent, 0, numbers, memory, 0, 0)
        assert np.abs(sent).max() < 1.0
        act(sent, 0, numbers, memory, 0, 0)
        fast.act(np.asfortranarray(wanted, np.float64), expected, np.zeros(1, np.int64), SIMULATION, streams)
        assert_allclose(memory, expected.T, atol=1e-6)
    unchanged = wanted.T.astype(np.float64)
    compensate(unchanged, 0, Loop(actuators=(fast,)).numbers(SIMULATION.period), memory, 0, 0)
    assert_array_equal(unchanged, wanted.T)
