"""The linear model of a control period, compared with the linearised Lagrangian of sympy, sampled exactly."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.linalg import expm

from quadpend_baselines.modelling.linear_model import (
    EULER,
    MODEL_STATE_SIZE,
    PENDULUM,
    PENDULUM_RATE,
    linearise,
)
from quadpend_gym import PAPER, Parameters, Simulation
from quadpend_gym.core.arrays import Floats
from tests.helpers import symbolic as symbolic
from tests.helpers.controllers import simulation_of
from tests.helpers.physics import UNEQUAL

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
    model = linearise(simulation_of(parameters, period=period))
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
