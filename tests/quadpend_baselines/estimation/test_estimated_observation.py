"""Observations made from a state, and the observation that a controller estimates."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.estimation.estimator import measurement_from_observation, observation_from_state
from quadpend_gym import PAPER
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.state import STATE_SIZE, State
from quadpend_gym.tasks.observation import OUTPUT_FEEDBACK_COLUMNS

ROD = PAPER.rod_length


def random_states(rows: int) -> Floats:
    """States in the reference's frame with unit directions, shape (rows, 18)."""
    state = np.random.default_rng(0).normal(size=(rows, STATE_SIZE))
    direction = State(state).direction
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return state


def random_observations(rows: int, output_feedback: bool) -> Floats32:
    """Observations with a random reference, shape (rows, 36) or (rows, 27)."""
    observation = np.random.default_rng(1).normal(size=(rows, 36)).astype(np.float32)
    return observation[:, OUTPUT_FEEDBACK_COLUMNS] if output_feedback else observation


@pytest.mark.parametrize("output_feedback", [False, True])
def test_observation_from_state_inverts_measurement_from_observation(output_feedback: bool) -> None:
    """For any yaw reference, with and without velocities in the measured observation."""
    state, measured = random_states(200), random_observations(200, output_feedback)
    observation = observation_from_state(state, measured, ROD)
    assert observation.shape == (200, 36)
    assert observation.dtype == np.float32
    again = measurement_from_observation(observation, ROD)
    assert_allclose(again.state, state, atol=3e-6)
    assert_array_equal(again.reference, measurement_from_observation(measured, ROD).reference)
    assert_array_equal(again.yaw_reference, measurement_from_observation(measured, ROD).yaw_reference)
    assert_allclose(observation_from_state(again.state, observation, ROD), observation, atol=1e-5)
