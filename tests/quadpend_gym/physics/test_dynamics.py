"""Conservation laws and symmetries of the equations of motion, and the order of the integrator."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import (
    COMMAND_SIZE,
    COMMAND_TORQUE,
    DISTURBANCE_SIZE,
    STATE_SIZE,
    Disturbance,
    State,
)
from tests.helpers.controllers import rotate_states, rotate_vectors
from tests.helpers.physics import UNEQUAL, random_commands, random_disturbances, random_states, simulate_period

ROWS = 50
NO_COMMAND, NO_DISTURBANCE = np.zeros(COMMAND_SIZE), np.zeros(DISTURBANCE_SIZE)
UP = np.array([0.0, 0.0, 1.0])


def tumbling(seed: int) -> tuple[Floats, Floats, Floats]:
    """Draw the states, commands and disturbances of `ROWS` tumbling sub-environments."""
    return random_states(ROWS, seed), random_commands(ROWS, seed, UNEQUAL), random_disturbances(ROWS, seed)


def energy(state: Floats) -> Floats:
    """Return the kinetic plus potential energy in J, equations (2)–(5) of the paper, shape (n,)."""
    s, p = State(state), UNEQUAL
    bob_velocity, bob = s.velocity + p.rod_length * s.direction_rate, s.position + p.rod_length * s.direction
    squares = [np.sum(rate**2, -1) for rate in (s.velocity, bob_velocity)]
    turning = np.sum(s.euler_rate**2 * [p.inertia_roll, p.inertia_pitch, p.inertia_yaw], -1)
    moving = [0.5 * squares[0] + p.gravity * s.position[:, 2], 0.5 * squares[1] + p.gravity * bob[:, 2]]
    return np.asarray(p.quadrotor_mass * moving[0] + p.bob_mass * moving[1] + 0.5 * turning)


def test_energy_is_conserved_without_inputs() -> None:
    state = random_states(ROWS, 1)
    after = simulate_period(state, NO_COMMAND, NO_DISTURBANCE, UNEQUAL, period=10.0, substeps=8000)
    assert_allclose(energy(after), energy(state), rtol=0.0, atol=1e-8)


def test_integrator_is_of_fourth_order() -> None:
    state, command, disturbance = tumbling(5)
    substeps = np.array([40, 80, 160, 320])
    exact = simulate_period(state, command, disturbance, UNEQUAL, period=0.2, substeps=5000)
    errors = [
        State(np.abs(simulate_period(state, command, disturbance, UNEQUAL, 0.2, int(n)) - exact)) for n in substeps
    ]
    for field in ("position", "velocity", "direction", "direction_rate"):
        largest = [getattr(error, field).max() for error in errors]
        slope = np.polyfit(np.log(0.2 / substeps), np.log(largest), 1)[0]
        assert slope == pytest.approx(4.0, abs=0.15), field


def test_the_attitude_is_integrated_exactly() -> None:
    """η̈ is constant during a period, so the attitude is a quadratic function of time for any number of substeps."""
    state, command, disturbance = tumbling(6)
    s = State(state)
    inertia = np.array([UNEQUAL.inertia_roll, UNEQUAL.inertia_pitch, UNEQUAL.inertia_yaw])
    euler_ddot = (command[:, COMMAND_TORQUE:] + Disturbance(disturbance).torque) / inertia
    for substeps in (1, 20):
        after = State(simulate_period(state, command, disturbance, UNEQUAL, 0.5, substeps))
        assert_allclose(after.euler, s.euler + 0.5 * s.euler_rate + 0.125 * euler_ddot, rtol=0.0, atol=1e-13)
        assert_allclose(after.euler_rate, s.euler_rate + 0.5 * euler_ddot, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("yaw", [0.3, np.pi / 2, -2.0])
def test_a_rotation_about_the_vertical_rotates_the_motion(yaw: float) -> None:
    """Of the disturbance, both forces rotate; the torque is about the φ, θ and ψ axes and does not change."""
    state, command, disturbance = tumbling(7)
    turned = disturbance.copy()
    turned[:, :6] = rotate_vectors(disturbance[:, :6].reshape(-1, 2, 3), yaw).reshape(-1, 6)
    here = simulate_period(state, command, disturbance, UNEQUAL, 0.5, 100)
    there = simulate_period(rotate_states(state, yaw), command, turned, UNEQUAL, 0.5, 100)
    assert_allclose(there, rotate_states(here, yaw), rtol=0.0, atol=1e-11)


def swing(direction: ArrayLike, rate: ArrayLike) -> Floats:
    """Return the state of a level quadrotor at rest with a moving pendulum, shape (1, 18)."""
    state = np.zeros((1, STATE_SIZE))
    State(state).direction[:], State(state).direction_rate[:] = direction, rate
    return state


@pytest.mark.parametrize("beta", [0.0, 1.0, 2.5, -2.0])
def test_motion_is_smooth_through_upright_in_every_direction(beta: float) -> None:
    """The motion from the upright state is the mean of the motions from two adjacent states, to second order."""
    heading = np.array([np.cos(beta), np.sin(beta), 0.0])
    command, disturbance = np.array([8.0, 0.1, -0.2, 0.05]), np.array([0.5, -0.3, 0.2, 0.1, 0.4, -0.2, 0.0, 0.0, 0.0])
    tilt = 1e-4
    states = [
        swing(np.sin(angle) * heading + np.cos(angle) * UP, 5.0 * (np.cos(angle) * heading - np.sin(angle) * UP))
        for angle in (-tilt, 0.0, tilt)
    ]
    before, at, after = (simulate_period(state, command, disturbance, UNEQUAL, 0.2, 40) for state in states)
    assert_allclose(at, (before + after) / 2.0, rtol=0.0, atol=1e3 * tilt**2)
    assert np.abs(after - before).max() < 1e3 * tilt
