"""Turbulence has the specified variance and correlation, for every control period and from the first step.

This file states the specifications independently of the code, in their own units and variables: the densities of
MIL-F-8785C in the spatial frequency Ω = ω/V. Estimates from random numbers may deviate by five standard errors, which
follow from the number of rows.
"""

from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats
from scipy.integrate import quad

from quadpend_gym import Dryden, OrnsteinUhlenbeck
from quadpend_gym.core.arrays import Floats
from tests.helpers.wind import five_sigma, iterate_wind, sample_wind

Density = Callable[[Any], Any]  # one-sided, per rad/s
VELOCITY = slice(9, 12)
FOOT, KNOT = 0.3048, 1852.0 / 3600.0
HEADING, SPEED = 0.7, 20.0  # rad; m/s, high for a low altitude, so that T_u is about 2 s and T_w about 0.3 s
SETTINGS: dict[str, Any] = {"intensity": "severe", "mean_wind": SPEED, "heading": HEADING}
DRYDEN = Dryden(**SETTINGS)
NOISE = OrnsteinUhlenbeck(force=0.0, velocity=(0.5, 2.0, 1.0), time_constant=0.5)


def specified_parameters(altitude: float, wind_20: float) -> tuple[float, float, float, float]:
    """Return σ_u, σ_w (m/s) and L_u, L_w (m) of MIL-F-8785C at low altitude, from altitude (m) and W₂₀ (m/s)."""
    feet = altitude / FOOT
    shape = 0.177 + 0.000823 * feet
    up = 0.1 * wind_20
    return up / shape**0.4, up, feet / shape**1.2 * FOOT, altitude


def dryden_densities(sigma: float, length: float, speed: float) -> tuple[Density, Density]:
    """Return Φ_u and Φ_v = Φ_w of MIL-F-8785C, 3.7.1.2: densities in Ω = ω/V, with Φ(ω) = Φ(Ω)/V."""

    def along(omega: Any) -> Any:
        x = length * omega / speed
        return sigma**2 * 2.0 * length / np.pi / (1.0 + x**2) / speed

    def across(omega: Any) -> Any:
        x = length * omega / speed
        return sigma**2 * length / np.pi * (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2 / speed

    return along, across


def low_altitude(altitude: float, wind_20: float, speed: float) -> list[Density]:
    """Return the densities of u, v, w at low altitude."""
    sigma_u, sigma_w, length_u, length_w = specified_parameters(altitude, wind_20)
    along, across = dryden_densities(sigma_u, length_u, speed)
    return [along, across, dryden_densities(sigma_w, length_w, speed)[1]]


def exponential_density(sigma: float, time: float) -> Density:
    """Return the density of noise with the autocorrelation σ² e^{−τ/T}."""
    return lambda omega: 2.0 * sigma**2 * time / np.pi / (1.0 + (time * omega) ** 2)


SEVERE = 20.0 * FOOT, 45.0 * KNOT, SPEED
CASES: dict[str, tuple[Any, list[Density]]] = {
    "ornstein_uhlenbeck": (NOISE, [exponential_density(sigma, 0.5) for sigma in (0.5, 2.0, 1.0)]),
    "dryden": (DRYDEN, low_altitude(*SEVERE)),
}
every_case = pytest.mark.parametrize(("wind", "densities"), CASES.values(), ids=CASES.keys())


def along_wind(wind: Any, velocity: Floats) -> Floats:
    """Convert a wind velocity to u, v, w without the mean wind; for `OrnsteinUhlenbeck` return x, y, z unchanged."""
    if isinstance(wind, OrnsteinUhlenbeck):
        return velocity
    x, y, z = np.moveaxis(velocity, -1, 0)
    cosine, sine = np.cos(HEADING), np.sin(HEADING)
    return np.stack([cosine * x + sine * y - SPEED, cosine * y - sine * x, z], axis=-1)


def autocovariance(density: Density, lag: float) -> float:
    """Return ∫₀^∞ Φ cos ωτ dω, the autocovariance by the Wiener–Khinchin theorem."""
    if lag == 0.0:
        return float(quad(density, 0.0, np.inf, limit=400)[0])
    return float(quad(density, 0.0, np.inf, weight="cos", wvar=lag, limlst=400, limit=400)[0])


@pytest.mark.parametrize(("period", "steps"), [(0.1, 21), (0.01, 201)])
@every_case
def test_deviation_and_autocorrelation_match_the_specification(
    wind: Any, densities: list[Density], period: float, steps: int
) -> None:
    rows = 10_000
    kept = {0, 1, round(0.3 / period), steps - 1}
    flow = enumerate(islice(iterate_wind(wind, rows, period), steps))
    seen = {step: along_wind(wind, out[:, VELOCITY]) for step, out in flow if step in kept}
    for axis, density in enumerate(densities):
        sigma = np.sqrt(autocovariance(density, 0.0))
        for now in kept:
            values = seen[now][:, axis] / sigma
            assert_allclose(values.std(), 1.0, atol=five_sigma(rows) / np.sqrt(2.0))
            assert_allclose(values.mean(), 0.0, atol=five_sigma(rows))
            assert stats.kstest(values, "norm").pvalue > 1e-5
            correlation = np.mean(seen[0][:, axis] / sigma * values)
            expected = autocovariance(density, now * period) / sigma**2
            assert_allclose(correlation, expected, atol=np.sqrt(1.0 + expected**2) * five_sigma(rows))


def test_the_heading_is_the_direction_of_the_mean_wind() -> None:
    wind, speed = sample_wind(Dryden(heading=2.5), 1, 10_000)[0], 15.0 * KNOT
    assert_array_equal(wind[:, :9], 0.0)
    expected = [speed * np.cos(2.5), speed * np.sin(2.5), 0.0]
    assert_allclose(wind[:, VELOCITY].mean(axis=0), expected, atol=Dryden().deviations.max() * five_sigma(10_000))
