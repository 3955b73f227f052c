"""Measurements and a memory of them as inputs of a network, and their teacher."""

from dataclasses import replace

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import MemoryOnly, VectorHybridWrapper
from quadpend_gym import Simulation
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK, OUTPUT_FEEDBACK_COLUMNS, OUTPUT_FEEDBACK_FIELDS
from tests.helpers.envs import make_vec

OUTPUTS = Loop(observation=OUTPUT_FEEDBACK)
ATTITUDE = OUTPUT_FEEDBACK_FIELDS["attitude"]
SHARES = (1.0 - np.exp(-0.01 / np.array([0.02, 0.06, 0.2, 0.6, 2.0])))[:, np.newaxis]


def test_the_filters_follow_measurements_and_actions_and_begin_anew() -> None:
    env, hybrid, memory = make_vec(2, wind="windy"), MemoryOnly(), None
    observation, last = env.reset(seed=0)[0], np.zeros((2, 5, 12))
    for step in range(40):
        started = np.array([step == 0, step in (0, 30)])
        seen, memory = hybrid.observe(observation, memory, started)
        now = seen[:, :12].astype(np.float64)
        np.testing.assert_allclose(now[:, 2], observation[:, 2] * 0.5 / 0.05, rtol=1e-5)
        last[started] = now[started, np.newaxis]
        last = last + SHARES * (now[:, np.newaxis] - last)
        np.testing.assert_allclose(seen[:, -63:-3].reshape(2, 5, 12), now[:, np.newaxis] - last, rtol=1e-3, atol=1e-4)
        assert (now[started, 8:] == 0.0).all()
        action, memory = hybrid.act(0.1 * env.action_space.sample(), memory)
        observation, *_ = env.step(action)
    assert np.abs(last).max() > 0.01


def test_the_inputs_do_not_depend_on_the_heading_and_need_no_velocities() -> None:
    observation = make_vec(1, wind="windy").reset(seed=0)[0]
    turned, start = observation.copy(), np.ones(1, np.bool_)
    sine, cosine = np.sin(0.7), np.cos(0.7)
    for first in (0, 6, *range(18, 33, 3)):
        x, y = observation[0, first : first + 2]
        turned[0, first : first + 2] = cosine * x - sine * y, sine * x + cosine * y
    turned[0, 33] += 0.7
    expected = MemoryOnly().observe(observation, None, start)[0]
    np.testing.assert_allclose(MemoryOnly().observe(turned, None, start)[0], expected, atol=1e-5)
    without = observation[:, OUTPUT_FEEDBACK_COLUMNS]
    flown = MemoryOnly().flown_in(Simulation(), OUTPUTS)
    np.testing.assert_array_equal(flown.observe(without, None, start)[0], expected)


def test_a_designed_hybrid_teaches_what_its_base_controller_does_and_a_flown_one_has_no_teacher() -> None:
    scenario = replace(find_scenario("vehicles_windy@racer"), observation=OUTPUT_FEEDBACK)
    env = VectorHybridWrapper(scenario.make_vec(3), MemoryOnly(), Loop.known(scenario), teaches=True)
    teacher, inner, memory = controller("lqg").adapt(scenario), scenario.make_vec(3), None
    env.reset(seed=1)
    plain = inner.reset(seed=1)[0]
    for step in range(30):
        expected, memory = teacher.predict(plain, memory, np.full(3, step == 0))
        np.testing.assert_allclose(env.base_action, expected, atol=1e-6)
        env.step(env.base_action)
        plain = inner.step(expected)[0]
    flown = MemoryOnly().designed_for(scenario.simulation).flown_in(scenario.simulation, OUTPUTS)
    for hybrid in (flown, MemoryOnly().flown_in(Simulation(), OUTPUTS)):
        memory = hybrid.observe(plain, None, np.ones(3, np.bool_))[1]
        assert memory.controller == ()
        with pytest.raises(ValueError, match="has no teacher"):
            hybrid.base_action(memory)


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_the_least_squares_are_the_body_rate_of_an_action(period: float) -> None:
    """Of vehicles without lag that turn at 5 and 10 rad/s with an action of 1. Few slow actions favour the prior."""
    hybrid, memory = MemoryOnly().flown_in(Simulation(period=period), OUTPUTS), None
    observation = np.zeros((2, 27), np.float32)
    rates = np.array([[5.0, 5.0], [10.0, 10.0]])
    for step in range(round(10.0 / period)):
        seen, memory = hybrid.observe(observation, memory, np.full(2, step == 0))
        action = np.zeros((2, 4), np.float32)
        action[:, 1:3] = 0.1 * np.array([np.sin(30.0 * period * step), np.cos(7.0 * period * step)])
        _, memory = hybrid.act(action, memory)
        observation[:, ATTITUDE.start : ATTITUDE.start + 2] += period * rates * action[:, 1:3] / 0.25
    np.testing.assert_allclose(7.5 + 3.75 * seen[:, -3:], np.repeat(rates[:, :1], 3, axis=1), rtol=0.2)
