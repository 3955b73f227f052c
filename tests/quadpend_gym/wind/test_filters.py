"""Linear filters of white noise are discretised exactly for every sampling period."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad_vec
from scipy.linalg import expm

from quadpend_gym import Dryden, VonKarman
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind.filters import Filter, discretise, draw_stationary, from_transfer_function, square_root
from tests.helpers.wind import five_sigma

ROOT, DAMPING, DRIVE = 3.0, 0.2, 0.7  # ω in rad/s, ζ, and the size of the noise
OSCILLATOR = Filter(
    np.array([[0.0, 1.0], [-(ROOT**2), -2.0 * DAMPING * ROOT]]), np.array([[0.0], [DRIVE]]), np.array([[1.0, 0.0]])
)
CHAIN = from_transfer_function([1.0, 2.7478, 0.3398], [1.0, 2.9958, 1.9754, 0.1539], gain=1.0, time=1.0)
SYSTEMS = {
    "oscillator": OSCILLATOR,
    "chain": CHAIN,  # three time constants, the longest ten times the shortest
    "dryden": Dryden("severe").filter,
    "von_karman": VonKarman("severe").filter,
}
every_system = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS.keys())


def noise_covariance(system: Filter, period: float) -> Floats:
    """∫₀ᵀ e^{A s} B Bᵀ e^{Aᵀ s} ds by adaptive quadrature."""

    def integrand(s: float) -> Any:
        response = expm(system.a * s) @ system.b
        return response @ response.T

    return np.asarray(quad_vec(integrand, 0.0, period, epsabs=0.0, epsrel=1e-12)[0])


def assert_close(covariance: Floats, expected: Floats, tolerance: float) -> None:
    """Check that covariances are equal relative to the standard deviations of row and column."""
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert_allclose(covariance / scale, expected / scale, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("period", [0.002, 0.1, 1.0])
def test_the_discretised_oscillator_equals_its_closed_form(period: float) -> None:
    """x(t) = e^{−ζωt} (x₀ cos ω_d t + (v₀ + ζω x₀)/ω_d sin ω_d t), column by column of Φ."""
    decay, turn = DAMPING * ROOT, ROOT * np.sqrt(1.0 - DAMPING**2)
    fade, cosine, sine = np.exp(-decay * period), np.cos(turn * period), np.sin(turn * period)
    rows = [[cosine + decay / turn * sine, sine / turn], [-(ROOT**2) / turn * sine, cosine - decay / turn * sine]]
    discrete = discretise(OSCILLATOR, period)
    assert_allclose(discrete.transition, fade * np.array(rows), rtol=0.0, atol=1e-14)
    assert_close(discrete.noise_gain @ discrete.noise_gain.T, noise_covariance(OSCILLATOR, period), 1e-10)


@every_system
@pytest.mark.parametrize("period", [1e-4, 1e-2, 1.0, 1000.0])
def test_the_stationary_covariance_is_invariant(system: Filter, period: float) -> None:
    """Φ P Φᵀ + L Lᵀ = P for every period."""
    discrete, covariance = discretise(system, period), system.stationary_covariance
    after = discrete.transition @ covariance @ discrete.transition.T + discrete.noise_gain @ discrete.noise_gain.T
    assert_close(after, covariance, 1e-12)
    root = square_root(covariance)
    assert_close(root @ root.T, covariance, 1e-12)


@every_system
@pytest.mark.parametrize("period", [1e-4, 1e-2])
def test_the_noise_covariance_of_short_periods_is_exact_and_not_negative(system: Filter, period: float) -> None:
    """Its smallest eigenvalue is of order T⁵, far below the rounding errors of the largest, which is of order T."""
    root = discretise(system, period).noise_gain
    assert np.linalg.eigvalsh(root @ root.T).min() > -1e-18
    assert_close(root @ root.T, noise_covariance(system, period), 1e-6)


def test_initial_states_have_the_stationary_distribution_and_do_not_depend_on_the_number_of_rows() -> None:
    rows, covariance = 20_000, OSCILLATOR.stationary_covariance
    streams = Streams(np.repeat(Streams.from_seeds([0]).keys, rows)).derive(np.arange(rows))
    memory = draw_stationary(square_root(covariance), streams)
    assert_allclose(np.cov((memory / np.sqrt(np.diag(covariance))).T), np.eye(2), atol=np.sqrt(2.0) * five_sigma(rows))
    assert_array_equal(draw_stationary(square_root(covariance), streams[:3]), memory[:3])
