"""Dual-mode control: the laws at its two ends, the change between them, exact tracking, and the remaining error."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_baselines.controllers.dual_mode import DualMode, DualModeGains
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqr import deviation, riccati
from quadpend_baselines.estimation.estimate import Estimate, law_inputs
from quadpend_baselines.gains import tuning
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.linear_model import model_state
from quadpend_gym import Reference, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from tests.helpers.controllers import (
    CALM,
    disturbance_of,
    hover_states,
    measurement_of,
    run_law,
    tilted_pendulum,
    true_estimate,
)

TUNED: DualModeGains = tuning("dual-mode").gains
SIMULATION = Simulation()
WIND = disturbance_of(force=(0.3, -0.2, 0.1), bob_force=(0.01, 0.0, 0.0), torque=(0.05, -0.02, 0.01))
ALWAYS_NEAR = replace(TUNED, near_error=1e8, far_error=1e9, near_tilt=10.0, far_tilt=11.0)
NEVER_NEAR = replace(TUNED, near_error=0.0, far_error=1e-9)
HOVER_AT_2_M = Reference.hover(z=2.0)


def command_of(gains: DualModeGains, state: Floats, disturbance: Floats = CALM) -> Floats:
    return run_law(DualMode(gains, SIMULATION), state, wind=disturbance, reference=HOVER_AT_2_M)[0]


def deviations(measurement: Estimate, disturbance: Floats) -> tuple[Floats, Floats]:
    """Return x − x_d of the linear model, shape (n, 16), and u_d, shape (n, 4), of true states."""
    array, found = true_estimate(measurement, disturbance).array, []
    for row in range(len(array)):
        inputs = law_inputs(array, row)
        x, command = deviation(*inputs, equivalent_model(SIMULATION).numbers, None)
        found.append((model_state(x, 0.0, 1.0), command))
    x, command = zip(*found, strict=True)
    return np.array(x), np.array(command)


def displaced(*offsets: float) -> Floats:
    states = hover_states(len(offsets))
    State(states).position[:, 0] += offsets
    return states


def test_near_the_reference_it_is_the_optimal_linear_feedback_in_wind() -> None:
    state = displaced(0.01)
    measurement = measurement_of(state, HOVER_AT_2_M)
    x, feedforward = deviations(measurement, WIND)
    gain, _ = riccati(TUNED.near, SIMULATION)
    assert_allclose(command_of(TUNED, state, WIND), feedforward - x @ gain.T, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("state", [displaced(1.0), tilted_pendulum(0.4, 1.0)], ids=["offset", "tilt"])
def test_far_from_the_reference_it_is_the_flatness_based_law(state: Floats) -> None:
    far, _ = run_law(Flatness(TUNED.far, SIMULATION), state, reference=HOVER_AT_2_M)
    assert_array_equal(command_of(TUNED, state), far)


def test_the_share_falls_linearly_with_the_remaining_error() -> None:
    state = displaced(0.14, 0.17, 0.2)
    measurement = measurement_of(state, HOVER_AT_2_M)
    x, _ = deviations(measurement, CALM)
    _, cost = riccati(TUNED.near, SIMULATION)
    error = TUNED.near.position * np.sqrt(SIMULATION.period * np.sum(x @ cost * x, axis=1))
    expected = (TUNED.far_error - error) / (TUNED.far_error - TUNED.near_error)
    assert ((expected > 0.05) & (expected < 0.95)).all()
    near, far = command_of(ALWAYS_NEAR, state), command_of(NEVER_NEAR, state)
    assert_allclose(command_of(TUNED, state), far + expected[:, np.newaxis] * (near - far), atol=1e-9)
