"""The linear model of a control period, compared with the linearised Lagrangian of sympy, sampled exactly."""

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose
from scipy.linalg import expm

from quadpend_baselines.modelling.linear_model import (
    MODEL_STATE_SIZE,
    linearise,
)
from quadpend_gym import PAPER, Parameters
from quadpend_gym.core.arrays import Floats
from tests.helpers import symbolic as symbolic
from tests.helpers.controllers import simulation_of
from tests.helpers.physics import UNEQUAL


@pytest.fixture(scope="module")
def rates() -> sp.Matrix:
    """[F | G | H] of ẋ = F x + G u + H d from Lagrange's equations; d_τ enters like the torques of the command."""
    found = symbolic.linearise()
    horizontal, _ = symbolic.HORIZONTAL
    angles = symbolic.phi, symbolic.theta, symbolic.psi
    position = symbolic.x, symbolic.y, symbolic.z
    x = [q for part in (position, angles) for q in (*part, *map(symbolic.rate_of, part))]
    x += [*horizontal, *map(symbolic.rate_of, horizontal)]
    thrust, *torques = symbolic.COMMAND
    inputs = [thrust, *torques, *symbolic.FORCE_ON_QUADROTOR, *symbolic.FORCE_ON_BOB[:2], *torques]
    return sp.Matrix([found[symbol] for symbol in x]).jacobian([*x, *inputs])


def sampled(rates: sp.Matrix, p: Parameters, period: float) -> Floats:
    """Return [A | B | E] for inputs that are constant over a period, by the matrix exponential."""
    values = p.quadrotor_mass, p.bob_mass, p.rod_length, p.gravity, p.inertia_roll, p.inertia_pitch, p.inertia_yaw
    numbers = rates.subs(dict(zip(symbolic.PARAMETERS, values, strict=True)))
    square = np.zeros((rates.shape[1], rates.shape[1]))
    square[:MODEL_STATE_SIZE] = np.array(numbers.subs({symbolic.COMMAND[0]: p.hover_thrust}), np.float64)
    return np.asarray(expm(period * square)[:MODEL_STATE_SIZE])


@pytest.mark.parametrize(("parameters", "period"), [(PAPER, 0.01), (UNEQUAL, 0.02)], ids=["paper", "unequal"])
def test_model_is_the_sampled_linearised_lagrangian(rates: sp.Matrix, parameters: Parameters, period: float) -> None:
    """The tolerance is 1e-8 of the differences plus that of Runge–Kutta, λ (λh)⁵/120 in each of 2 substeps."""
    model = linearise(simulation_of(parameters, period=period))
    actual, expected = np.hstack(model), sampled(rates, parameters, period)
    pole = np.sqrt(parameters.chain_stiffness)
    truncation = 2.0 * pole * (pole * period / 2.0) ** 5 / 120.0
    assert_allclose(actual, expected, rtol=0.0, atol=2e-8 + 1.2 * truncation)
