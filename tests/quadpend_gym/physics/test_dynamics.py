"""Conservation laws and symmetries of the equations of motion, and the order of the integrator."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.dynamics import accelerations
from quadpend_gym.physics.state import (
    COMMAND_SIZE,
    COMMAND_TORQUE,
    DISTURBANCE_SIZE,
    STATE_SIZE,
    THRUST,
    Disturbance,
    State,
)
from quadpend_gym.vehicles import Parameters
from tests.helpers.invariants import energy, momentum
from tests.helpers.physics import UNEQUAL, random_commands, random_disturbances, random_states, simulate_period

ROWS = 50
NO_COMMAND, NO_DISTURBANCE = np.zeros(COMMAND_SIZE), np.zeros(DISTURBANCE_SIZE)
UP = np.array([0.0, 0.0, 1.0])


def tumbling(seed: int, parameters: Parameters = UNEQUAL) -> tuple[Floats, Floats, Floats]:
    """Draw the states, commands and disturbances of `ROWS` tumbling sub-environments."""
    return random_states(ROWS, seed), random_commands(ROWS, seed, parameters), random_disturbances(ROWS, seed)


def state_rate(state: Floats, command: Floats, disturbance: Floats, parameters: Parameters) -> Floats:
    """Return the time derivative of the state, shape (n, 18)."""
    s, rate = State(state), State(np.empty_like(state))
    second = accelerations(state, command, disturbance, parameters)
    rate.position[:], rate.velocity[:] = s.velocity, second.position
    rate.euler[:], rate.euler_rate[:] = s.euler_rate, second.euler
    rate.direction[:], rate.direction_rate[:] = s.direction_rate, second.direction
    return rate.array


def thrust_force(state: Floats, command: Floats) -> Floats:
    """Return u R e₃ from the product of the three rotation matrices, N, shape (n, 3)."""
    (s1, s2, s3), (c1, c2, c3) = np.sin(State(state).euler).T, np.cos(State(state).euler).T
    zero, one = np.zeros_like(s1), np.ones_like(s1)
    roll = np.array([[one, zero, zero], [zero, c1, -s1], [zero, s1, c1]])
    pitch = np.array([[c2, zero, s2], [zero, one, zero], [-s2, zero, c2]])
    yaw = np.array([[c3, -s3, zero], [s3, c3, zero], [zero, zero, one]])
    axis = np.einsum("ijn,jkn,kln,l->ni", yaw, pitch, roll, UP)
    return np.asarray(command[:, [THRUST]] * axis)


def test_the_rate_of_the_energy_is_the_power_of_the_inputs() -> None:
    """dE/dt = F·ζ̇ + d_B·ṗ + (τ + d_τ)·η̇."""
    state, command, disturbance = tumbling(0)
    s, d = State(state), Disturbance(disturbance)
    rate = state_rate(state, command, disturbance, UNEQUAL)
    # The energy is quadratic in the state except for linear terms, so this central difference is the exact derivative.
    energy_rate = (energy(state + rate, UNEQUAL) - energy(state - rate, UNEQUAL)) / 2.0
    bob_velocity = s.velocity + UNEQUAL.rod_length * s.direction_rate
    powers = np.concatenate(
        [
            (thrust_force(state, command) + d.force) * s.velocity,
            d.bob_force * bob_velocity,
            (command[:, COMMAND_TORQUE:] + d.torque) * s.euler_rate,
        ],
        axis=-1,
    )
    assert_allclose(energy_rate, powers.sum(-1), rtol=0.0, atol=1e-10 * np.abs(powers).max())


def test_energy_is_conserved_without_inputs() -> None:
    state = random_states(ROWS, 1)
    after = simulate_period(state, NO_COMMAND, NO_DISTURBANCE, UNEQUAL, period=10.0, substeps=8000)
    assert_allclose(energy(after, UNEQUAL), energy(state, UNEQUAL), rtol=0.0, atol=1e-8)


def test_momentum_changes_by_the_impulse_of_the_external_forces() -> None:
    state, command, disturbance = tumbling(3)
    period, intervals = 1.0, 400
    times = np.linspace(0.0, period, 2 * intervals + 1)
    weights = np.array([1.0, *[4.0, 2.0] * (intervals - 1), 4.0, 1.0]) / (6.0 * intervals)
    path = [simulate_period(state, command, disturbance, UNEQUAL, time, 200) for time in times]
    thrust = sum(w * thrust_force(point, command) for w, point in zip(weights, path, strict=True))
    weight = UNEQUAL.total_mass * UNEQUAL.gravity * UP
    impulse = thrust + period * (Disturbance(disturbance).force + Disturbance(disturbance).bob_force - weight)
    assert_allclose(momentum(path[-1], UNEQUAL) - momentum(state, UNEQUAL), impulse, rtol=0.0, atol=1e-7)


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


def rotate_vectors(array: Floats, rotation: Floats) -> Floats:
    """Rotate each of the k world vectors in the rows of an array of shape (n, 3 k)."""
    return np.asarray((array.reshape(len(array), -1, 3) @ rotation.T).reshape(array.shape))


def rotate_state(state: Floats, rotation: Floats, yaw: float = 0.0) -> Floats:
    """Return the states after a rotation of the world, which adds `yaw` to ψ."""
    result = rotate_vectors(state, rotation)
    State(result).euler[:] = State(state).euler + np.array([0.0, 0.0, yaw])
    State(result).euler_rate[:] = State(state).euler_rate
    return result


def rotate_disturbance(disturbance: Floats, rotation: Floats) -> Floats:
    """Return the disturbances with both forces rotated; the torque is about the φ, θ and ψ axes and does not change."""
    result = rotate_vectors(disturbance, rotation)
    Disturbance(result).torque[:] = Disturbance(disturbance).torque
    return result


@pytest.mark.parametrize("yaw", [0.3, np.pi / 2, -2.0])
def test_a_rotation_about_the_vertical_rotates_accelerations_and_motion(yaw: float) -> None:
    state, command, disturbance = tumbling(7)
    rotation = Rotation.from_euler("z", yaw).as_matrix()
    there = rotate_state(state, rotation, yaw), command, rotate_disturbance(disturbance, rotation), UNEQUAL

    here = accelerations(state, command, disturbance, UNEQUAL)
    after = accelerations(*there)
    assert_allclose(after.position, rotate_vectors(here.position, rotation), rtol=0.0, atol=1e-12)
    assert_allclose(after.euler, here.euler, rtol=0.0, atol=1e-12)
    assert_allclose(after.direction, rotate_vectors(here.direction, rotation), rtol=0.0, atol=1e-11)

    motion = simulate_period(state, command, disturbance, UNEQUAL, period=0.5, substeps=100)
    assert_allclose(simulate_period(*there, 0.5, 100), rotate_state(motion, rotation, yaw), rtol=0.0, atol=1e-11)


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
    motions = [simulate_period(state, command, disturbance, UNEQUAL, 0.2, 40) for state in states]
    rates = [state_rate(state, command, disturbance, UNEQUAL) for state in states]
    for before, at, after in (motions, rates):
        assert_allclose(at, (before + after) / 2.0, rtol=0.0, atol=1e3 * tilt**2)
        assert np.abs(after - before).max() < 1e3 * tilt
