"""The linear model of a control period: against the Lagrangian's linearisation by sympy, sampled exactly."""

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
    STATE_COLUMNS,
    linearise,
    rotate_state,
)
from quadpend_gym import PAPER, Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import STATE_SIZE
from tests.helpers import symbolic as symbolic
from tests.helpers.physics import UNEQUAL, simulate_period

PERIODS = (0.002, 0.01, 0.02)


@pytest.fixture(scope="module")
def rates() -> sp.Matrix:
    """[F | G | H] of ẋ = F x + G u + H d by Lagrange's equations; the torque's d_τ stands beside the torque."""
    model = symbolic.linearise()
    horizontal, _ = symbolic.HORIZONTAL
    angles = symbolic.phi, symbolic.theta, symbolic.psi
    place = symbolic.x, symbolic.y, symbolic.z
    x = [q for part in (place, angles) for q in (*part, *map(symbolic.rate_of, part))]
    x += [*horizontal, *map(symbolic.rate_of, horizontal)]
    thrust, *torques = symbolic.COMMAND
    inputs = [thrust, *torques, *symbolic.FORCE_ON_QUADROTOR, *symbolic.FORCE_ON_BOB[:2], *torques]
    return sp.Matrix([model.rates[symbol] for symbol in x]).jacobian([*x, *inputs])


def sampled(rates: sp.Matrix, p: Parameters, period: float) -> Floats:
    """[A | B | E] for inputs held over a period, by the matrix exponential."""
    values = p.quadrotor_mass, p.bob_mass, p.rod_length, p.gravity, p.inertia_roll, p.inertia_pitch, p.inertia_yaw
    numbers = rates.subs(dict(zip(symbolic.PARAMETERS, values, strict=True)))
    square = np.zeros((rates.shape[1], rates.shape[1]))
    square[:MODEL_STATE_SIZE] = np.array(numbers.subs({symbolic.COMMAND[0]: p.hover_thrust}), np.float64)
    return np.asarray(expm(period * square)[:MODEL_STATE_SIZE])


@pytest.mark.parametrize("parameters", [PAPER, UNEQUAL], ids=["paper", "unequal"])
@pytest.mark.parametrize("period", PERIODS)
def test_it_is_the_lagrangian_linearised_and_held_over_a_period(
    rates: sp.Matrix, parameters: Parameters, period: float
) -> None:
    """To the differences' 1e-8 and what Runge–Kutta lacks of e^(λh): (λh)⁵/120 in each of 2 substeps, times λ in ṙ."""
    model = linearise(Simulation(parameters, period=period))
    actual, wanted = np.hstack(model), sampled(rates, parameters, period)
    pole = np.sqrt(parameters.chain_stiffness)
    lacking = 2.0 * pole * (pole * period / 2.0) ** 5 / 120.0
    assert_allclose(actual, wanted, rtol=0.0, atol=2e-8 + 1.2 * lacking)
    assert [part.shape for part in model] == [(16, 16), (16, 4), (16, 8)]


def test_its_error_is_of_the_order_of_runge_and_kutta(rates: sp.Matrix) -> None:
    """Over a fixed time of 0.1 s, in 1, 2 and 4 substeps, before the differences' own 1e-8 shows."""
    wanted = sampled(rates, PAPER, 0.1)
    errors = [
        np.abs(np.hstack(linearise(Simulation(period=0.1, substeps=substeps))) - wanted).max() for substeps in (1, 2, 4)
    ]
    assert errors[2] > 1e-6
    slopes = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert_allclose(slopes, 4.0, atol=0.15)


def test_the_pendulum_falls_with_the_papers_stiffness() -> None:
    """r̈ = K (r − θ), (26): A has e^(±√K T) twice, and a lean of the thrust pushes as much as one of the pendulum."""
    period = 0.01
    transition = linearise(Simulation(period=period)).transition
    pole = np.sqrt(PAPER.chain_stiffness)
    falling = transition[PENDULUM.start : PENDULUM_RATE.stop, PENDULUM.start : PENDULUM_RATE.stop]
    found = np.sort(np.linalg.eigvals(falling).real)
    assert_allclose(found, np.repeat(np.exp([-pole * period, pole * period]), 2), rtol=1e-8)
    leant = np.zeros(MODEL_STATE_SIZE)
    leant[PENDULUM.start] = leant[EULER.start + 1] = 1.0  # r_x = θ: along the thrust
    assert_allclose(transition[PENDULUM_RATE] @ leant, 0.0, atol=1e-7)


def test_small_deviations_fly_as_it_says_up_to_their_square() -> None:
    """The kernel itself, with everything deviating at once: a tenth of the deviation has a hundredth of the error."""
    simulation = Simulation(UNEQUAL)
    rng = np.random.default_rng(5)
    x, command, forces = (
        rng.normal(size=MODEL_STATE_SIZE),
        rng.normal(size=4),
        rng.normal(size=DISTURBANCE_COLUMNS.size),
    )
    linear = sum(part @ y for part, y in zip(linearise(simulation), (x, command, forces), strict=True))

    def error(size: float) -> float:
        state, disturbance = np.zeros(STATE_SIZE), np.zeros(9)
        state[STATE_COLUMNS], disturbance[DISTURBANCE_COLUMNS] = size * x, size * forces
        r, v = state[12:15], state[15:18]
        r[2] = np.sqrt(1.0 - r[0] ** 2 - r[1] ** 2)
        v[2] = -(r[:2] @ v[:2]) / r[2]
        pushed = size * command + [UNEQUAL.hover_thrust, 0.0, 0.0, 0.0]
        after = simulate_period(state, pushed, disturbance, UNEQUAL, simulation.period, simulation.substeps)[0]
        return float(np.abs(after[STATE_COLUMNS] - size * linear).max())

    large, small = error(1e-2), error(1e-3)
    assert large < 1e-3
    assert 70.0 < large / small < 140.0


def test_turning_is_a_rotation_about_the_vertical() -> None:
    rng = np.random.default_rng(6)
    x, yaw = rng.normal(size=(5, MODEL_STATE_SIZE)), rng.uniform(-4.0, 4.0, 5)
    turned = rotate_state(x, yaw)
    assert_allclose(rotate_state(turned, -yaw), x, atol=1e-14)
    assert_allclose(rotate_state(turned, 0.3 - yaw), rotate_state(x, np.full(5, 0.3)), atol=1e-14)
    assert_allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(x, axis=1), rtol=1e-14)
    body = np.r_[EULER, EULER_RATE]
    assert_allclose(turned[:, body], x[:, body], rtol=0.0)
    ahead = np.eye(MODEL_STATE_SIZE)[[0, 3, PENDULUM.start, PENDULUM_RATE.start]]
    left = np.eye(MODEL_STATE_SIZE)[[1, 4, PENDULUM.start + 1, PENDULUM_RATE.start + 1]]
    assert_allclose(rotate_state(ahead, np.full(4, np.pi / 2)), left, atol=1e-15)  # counter-clockwise seen from above


def test_in_the_headings_axes_the_plant_is_the_same_whatever_the_yaw() -> None:
    """A x of a turned world is A x turned: what the controllers rely on when they turn x and not the gains."""
    simulation, yaw = Simulation(UNEQUAL), 0.7
    x = 1e-5 * np.random.default_rng(7).normal(size=(1, MODEL_STATE_SIZE))
    state = np.zeros((1, STATE_SIZE))
    state[:, STATE_COLUMNS], state[:, 14] = rotate_state(x, np.array([yaw])), 1.0
    state[:, 8] += yaw
    hover = np.array([UNEQUAL.hover_thrust, 0.0, 0.0, 0.0])
    after = simulate_period(state, hover, np.zeros(9), UNEQUAL, simulation.period, simulation.substeps)[
        :, STATE_COLUMNS
    ]
    after[:, 8] -= yaw
    assert_allclose(rotate_state(after, np.array([-yaw])), x @ linearise(simulation).transition.T, atol=1e-8)
