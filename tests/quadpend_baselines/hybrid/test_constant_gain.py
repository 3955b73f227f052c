"""The filter of constant gain of a network: near hover it is the observer of `lqg`, and the reference may jump."""

from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_baselines.controllers.lqg import evaluate
from quadpend_baselines.estimation.estimate import nominal
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.constant_gain import constant_gain
from quadpend_baselines.hybrid.lab import FILTER, lab_part
from quadpend_baselines.hybrid.parts import Seen
from quadpend_baselines.registry import controller
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.tasks.observation import LAB

ROWS, POSITIONS, RATES = 4, slice(0, 16), slice(3, 6)


def flown(name: str, steps: int, jump: int | None = None) -> tuple[Any, Any, Any]:
    """Return z of `lqg` and of the filter, and its innovations, while `lqg` flies; from step `jump` on 0.5 m aside."""
    scenario = find_scenario(name)
    policy: Any = controller("lqg").designed_for(scenario.simulation, Loop.known(scenario))
    part, env = lab_part(scenario.simulation), scenario.make_vec(ROWS)
    observation, _ = env.reset(seed=7)
    own, action, started = np.zeros((ROWS, part.memory_size)), np.zeros((ROWS, 4), np.float32), np.ones(ROWS, np.bool_)
    memory, expected, found = None, [], []
    for step in range(steps):
        if jump is not None and step >= jump:
            observation = observation.copy()
            observation[:, LAB.columns["reference_0"].start] += 0.5
        memory = policy.update(observation, memory, started)
        inputs, own = part.function(part.numbers, Seen(observation, action, *[np.zeros((ROWS, 4))] * 3), own)
        later = policy.estimator.prediction.carry_forward(memory.estimate, memory.action)
        expected.append(evaluate(policy._law, nominal(later))[2])
        found.append(inputs[:, FILTER])
        action, memory = policy.control(memory)
        memory = policy.with_applied_action(memory, action)
        observation, _, _, _, _ = env.step(action)
        started = np.zeros(ROWS, np.bool_)
    states = np.array(found)[..., :28] * constant_gain(scenario.simulation).scales
    return np.array(expected), states, np.array(found)[..., 28:36]


def test_it_is_the_observer_of_lqg_near_hover_and_on_a_reference() -> None:
    """Not compared: the rate of the yaw, which hardly moves, and on a reference the vertical, whose axis is turned."""
    for name, share, left_out in (("flight_breeze", 0.1, [11]), ("flight_training_wide", 0.2, [2, 5, 11])):
        expected, states, _ = (item[100:, :, POSITIONS] for item in flown(name, 400))
        error = np.sqrt(((states - expected) ** 2).mean((0, 1)) / (expected**2).mean((0, 1)))
        assert (np.delete(error, left_out) < share).all(), error


def test_a_jump_of_the_reference_is_no_motion() -> None:
    """Only the tracking error jumps: no velocity, and no innovation."""
    _, still, _ = flown("flight_breeze", 60)
    _, jumped, innovation = flown("flight_breeze", 51, jump=50)
    np.testing.assert_allclose(jumped[50, :, 0:2] - still[50, :, 0:2], np.tile([-0.5, 0.0], (ROWS, 1)), atol=0.2)
    np.testing.assert_allclose(jumped[50, :, RATES], still[50, :, RATES], atol=0.02)
    assert np.abs(innovation).max() < 2.0


def test_the_latency_is_in_the_memory() -> None:
    simulation = find_scenario("flight_breeze").simulation
    sizes = [constant_gain(replace(simulation, latency=latency)).memory_size for latency in (0.0, 0.02, 0.03)]
    assert np.diff(sizes).tolist() == [8, 4]
