"""The linear model of a control period, compared with the linearised Lagrangian of sympy, sampled exactly."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.linalg import expm

from quadpend_baselines.modelling.linear_model import (
    DISTURBANCE_COLUMNS,
    EULER,
    EULER_RATE,
    MODEL_STATE_SIZE,
    PENDULUM,
    PENDULUM_RATE,
    POSITION,
    STATE_COLUMNS,
    VELOCITY,
    YAW,
    linearise,
    rotate_state,
)
from quadpend_gym import PAPER, Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from tests.helpers import symbolic as symbolic
from tests.helpers.physics import UNEQUAL, simulate_period

PERIODS = (0.002, 0.01, 0.02)


@pytest.fixture(scope="module")
def rates() -> sp.Matrix:
    """[F | G | H] of ẋ = F x + G u + H d from Lagrange's equations; d_τ enters like the torques of the command."""
    model = symbolic.linearise()
    horizontal, _ = symbolic.HORIZONTAL
    angles = symbolic.phi, symbolic.theta, symbolic.psi
    position = symbolic.x, symbolic.y, symbolic.z
    x = [q for part in (position, angles) for q in (*part, *map(symbolic.rate_of, part))]
    x += [*horizontal, *map(symbolic.rate_of, horizontal)]
    thrust, *torques = symbolic.COMMAND
    inputs = [thrust, *torques, *symbolic.FORCE_ON_QUADROTOR, *symbolic.FORCE_ON_BOB[:2], *torques]
    return sp.Matrix([model.rates[symbol] for symbol in x]).jacobian([*x, *inputs])


def sampled(rates: sp.Matrix, p: Parameters, period: float) -> Floats:
    """Return [A | B | E] for inputs that are constant over a period, by the matrix exponential."""
    values = p.quadrotor_mass, p.bob_mass, p.rod_length, p.gravity, p.inertia_roll, p.inertia_pitch, p.inertia_yaw
    numbers = rates.subs(dict(zip(symbolic.PARAMETERS, values, strict=True)))
    square = np.zeros((rates.shape[1], rates.shape[1]))
    square[:MODEL_STATE_SIZE] = np.array(numbers.subs({symbolic.COMMAND[0]: p.hover_thrust}), np.float64)
    return np.asarray(expm(period * square)[:MODEL_STATE_SIZE])


@pytest.mark.parametrize("parameters", [PAPER, UNEQUAL], ids=["paper", "unequal"])
@pytest.mark.parametrize("period", PERIODS)
def test_model_is_the_sampled_linearised_lagrangian(rates: sp.Matrix, parameters: Parameters, period: float) -> None:
    """The tolerance is 1e-8 of the differences plus that of Runge–Kutta, λ (λh)⁵/120 in each of 2 substeps."""
    model = linearise(Simulation(parameters, period=period))
    actual, expected = np.hstack(model), sampled(rates, parameters, period)
    pole = np.sqrt(parameters.chain_stiffness)
    truncation = 2.0 * pole * (pole * period / 2.0) ** 5 / 120.0
    assert_allclose(actual, expected, rtol=0.0, atol=2e-8 + 1.2 * truncation)
    assert [part.shape for part in model] == [(16, 16), (16, 4), (16, 8)]


def test_error_of_the_model_has_the_order_of_runge_kutta(rates: sp.Matrix) -> None:
    """The slope is that of 1, 2 and 4 substeps over 0.1 s, where the error exceeds the 1e-8 of the differences."""
    expected = sampled(rates, PAPER, 0.1)
    errors = [
        np.abs(np.hstack(linearise(Simulation(period=0.1, substeps=substeps))) - expected).max()
        for substeps in (1, 2, 4)
    ]
    assert errors[2] > 1e-6
    slopes = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert_allclose(slopes, 4.0, atol=0.15)


def test_pendulum_modes_have_the_stiffness_of_the_paper() -> None:
    """By (26), r̈ = K (r − θ): A has the eigenvalues e^(±√K T) twice, and r = θ causes no acceleration."""
    period = 0.01
    transition = linearise(Simulation(period=period)).transition
    pole = np.sqrt(PAPER.chain_stiffness)
    pendulum = transition[PENDULUM.start : PENDULUM_RATE.stop, PENDULUM.start : PENDULUM_RATE.stop]
    actual = np.sort(np.linalg.eigvals(pendulum).real)
    assert_allclose(actual, np.repeat(np.exp([-pole * period, pole * period]), 2), rtol=1e-8)
    aligned = np.zeros(MODEL_STATE_SIZE)
    aligned[PENDULUM.start] = aligned[EULER.start + 1] = 1.0  # r_x = θ: the pendulum points along the thrust
    assert_allclose(transition[PENDULUM_RATE] @ aligned, 0.0, atol=1e-7)


def test_error_of_the_model_is_of_second_order_in_the_deviation() -> None:
    """All components deviate at once; a tenth of the deviation has a hundredth of the error."""
    simulation = Simulation(UNEQUAL)
    rng = np.random.default_rng(5)
    x, command, d = (
        rng.normal(size=MODEL_STATE_SIZE),
        rng.normal(size=4),
        rng.normal(size=DISTURBANCE_COLUMNS.size),
    )
    linear = sum(part @ y for part, y in zip(linearise(simulation), (x, command, d), strict=True))

    def error(size: float) -> float:
        state, disturbance = np.zeros(STATE_SIZE), np.zeros(DISTURBANCE_SIZE)
        state[STATE_COLUMNS], disturbance[DISTURBANCE_COLUMNS] = size * x, size * d
        r, v = State(state).direction, State(state).direction_rate
        r[2] = np.sqrt(1.0 - r[0] ** 2 - r[1] ** 2)
        v[2] = -(r[:2] @ v[:2]) / r[2]
        applied = size * command + [UNEQUAL.hover_thrust, 0.0, 0.0, 0.0]
        after = simulate_period(state, applied, disturbance, UNEQUAL, simulation.period, simulation.substeps)[0]
        return float(np.abs(after[STATE_COLUMNS] - size * linear).max())

    large, small = error(1e-2), error(1e-3)
    assert large < 1e-3
    assert 70.0 < large / small < 140.0


def test_rotate_state_is_a_rotation_about_the_vertical() -> None:
    rng = np.random.default_rng(6)
    x, yaw = rng.normal(size=(5, MODEL_STATE_SIZE)), rng.uniform(-4.0, 4.0, 5)
    rotated = rotate_state(x, yaw)
    assert_allclose(rotate_state(rotated, -yaw), x, atol=1e-14)
    assert_allclose(rotate_state(rotated, 0.3 - yaw), rotate_state(x, np.full(5, 0.3)), atol=1e-14)
    assert_allclose(np.linalg.norm(rotated, axis=1), np.linalg.norm(x, axis=1), rtol=1e-14)
    body = np.r_[EULER, EULER_RATE]
    assert_allclose(rotated[:, body], x[:, body], rtol=0.0)
    forward = np.eye(MODEL_STATE_SIZE)[[POSITION.start, VELOCITY.start, PENDULUM.start, PENDULUM_RATE.start]]
    left = np.eye(MODEL_STATE_SIZE)[
        [POSITION.start + 1, VELOCITY.start + 1, PENDULUM.start + 1, PENDULUM_RATE.start + 1]
    ]
    assert_allclose(
        rotate_state(forward, np.full(4, np.pi / 2)), left, atol=1e-15
    )  # counter-clockwise as seen from above


def test_model_in_the_axes_of_the_heading_does_not_depend_on_the_yaw() -> None:
    """The controllers rely on this symmetry: they rotate x instead of the gains."""
    simulation, yaw = Simulation(UNEQUAL), 0.7
    x = 1e-5 * np.random.default_rng(7).normal(size=(1, MODEL_STATE_SIZE))
    state = np.zeros((1, STATE_SIZE))
    state[:, STATE_COLUMNS] = rotate_state(x, np.array([yaw]))
    State(state).direction[:, 2] = 1.0
    State(state).euler[:, 2] += yaw
    hover = np.array([UNEQUAL.hover_thrust, 0.0, 0.0, 0.0])
    after = simulate_period(state, hover, np.zeros(DISTURBANCE_SIZE), UNEQUAL, simulation.period, simulation.substeps)[
        :, STATE_COLUMNS
    ]
    after[:, YAW] -= yaw
    assert_allclose(rotate_state(after, np.array([-yaw])), x @ linearise(simulation).transition.T, atol=1e-8)
