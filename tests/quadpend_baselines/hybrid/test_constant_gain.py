"""The filter of constant gain of a network: near hover it is the observer of `lqg`, and the reference may jump."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpend_baselines.controllers.lqg import evaluate
from quadpend_baselines.estimation.estimate import nominal
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.constant_gain import memory_size
from quadpend_baselines.hybrid.deviations import deviation_scales
from quadpend_baselines.hybrid.lab import FILTER, lab_part
from quadpend_baselines.hybrid.parts import Seen
from quadpend_baselines.registry import controller
from quadpend_gym.scenarios import find_scenario
from quadpend_gym.tasks.observation import LAB

ROWS, POSITIONS = 4, slice(0, 16)


def flown(name: str, steps: int, change: Any = None) -> tuple[Any, Any, Any]:
    """Return z of `lqg` and of the filter, and its innovations, while `lqg` flies on changed observations."""
    scenario = find_scenario(name)
    policy: Any = controller("lqg").designed_for(scenario.simulation, Loop.known(scenario))
    part, env = lab_part(scenario.simulation), scenario.make_vec(ROWS)
    observation, _ = env.reset(seed=7)
    own, action, started = np.zeros((ROWS, part.memory_size)), np.zeros((ROWS, 4), np.float32), np.ones(ROWS, np.bool_)
    memory, expected, found = None, [], []
    for step in range(steps):
        memory = policy.update(observation, memory, started)
        given = change(step, observation.copy()) if change else observation
        inputs, own = part.function(part.numbers, Seen(given, action, *[np.zeros((ROWS, 4))] * 3), own)
        later = policy.estimator.prediction.carry_forward(memory.estimate, memory.action)
        expected.append(evaluate(policy._law, nominal(later))[2])
        found.append(inputs[:, FILTER])
        action, memory = policy.control(memory)
        memory = policy.with_applied_action(memory, action)
        observation, _, _, _, _ = env.step(action)
        started = np.zeros(ROWS, np.bool_)
    states = np.array(found)[..., :28] * deviation_scales(scenario.simulation.parameters.hover_thrust)[4:32]
    return np.array(expected), states, np.array(found)[..., 28:36]


def test_it_is_the_observer_of_lqg_near_hover_and_on_a_reference() -> None:
    """Not compared: the rate of the yaw, which hardly moves, and on a reference the vertical, whose axis is turned."""
    for name, share, left_out in (("flight_breeze", 0.1, [11]), ("flight_training_wide", 0.2, [2, 5, 11])):
        expected, states, _ = (item[100:, :, POSITIONS] for item in flown(name, 400))
        error = np.sqrt(((states - expected) ** 2).mean((0, 1)) / (expected**2).mean((0, 1)))
        assert (np.delete(error, left_out) < share).all(), error


@pytest.mark.parametrize(("field", "distance"), [("reference_0", 0.5), ("reference_0", 8.0), ("yaw_reference", 3.3)])
def test_a_jump_of_the_reference_is_no_motion(field: str, distance: float) -> None:
    """Tracking error and yaw jump alone: no velocity, and no innovation, which is as large as before."""

    def jumped(step: int, observation: Any) -> Any:
        observation[:, LAB.columns[field].start] += distance * (step >= 50)
        return observation

    _, still, noise = flown("flight_breeze", 56)
    _, states, innovation = flown("flight_breeze", 56, jumped)
    np.testing.assert_allclose(states[50:, :, 3:8], still[50:, :, 3:8], atol=2e-3)
    np.testing.assert_allclose(np.abs(innovation).max(), np.abs(noise).max(), rtol=0.1)
    moved = states[50, :, 8] - still[50, :, 8] if field == "yaw_reference" else np.hypot(*states[50, :, :2].T)
    np.testing.assert_allclose(np.abs(moved), distance, rtol=0.1)


def test_it_predicts_through_missing_samples() -> None:
    """For 50 ms, in which `lqg` sees them."""
    held: list[Any] = []

    def missing(step: int, observation: Any) -> Any:
        if 50 <= step < 55:
            observation[:, :10] = held[-1]
        held.append(observation[:, :10].copy())
        return observation

    expected, states, innovation = flown("flight_breeze", 60, missing)
    assert (innovation[50:55] == 0.0).all()
    np.testing.assert_allclose(states[50:, :, 0:3], expected[50:, :, 0:3], atol=5e-3)
    np.testing.assert_allclose(states[50:, :, 6:8], expected[50:, :, 6:8], atol=0.02)


def test_the_latency_is_in_the_memory() -> None:
    simulation = find_scenario("flight_breeze").simulation
    sizes = [memory_size(replace(simulation, latency=latency)) for latency in (0.0, 0.02, 0.03)]
    assert np.diff(sizes).tolist() == [8, 4]
