"""Accuracy of the elementary functions, compared with 120-bit arithmetic."""

from collections.abc import Callable

import mpmath
import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import arcsin, arctan2, log, sincos

mpmath.mp.prec = 120


def largest_error(function: Callable[[float], float], exact: Callable[[float], mpmath.mpf], x: Floats) -> float:
    """Return the largest error over the points `x`, in units in the last place of the exact result."""
    return max(
        float(abs(mpmath.mpf(function(value)) - exact(value)) / np.spacing(abs(float(exact(value)))))
        for value in x.tolist()
    )


def angles() -> Floats:
    """Return angles up to 10⁵ rad, many of them in the two difficult places: at multiples of π/2, and π/6 from them.

    At π/6 the sine or cosine is just below one half, so its last place is half that of the reduced angle.
    """
    rng = np.random.default_rng(0)
    everywhere = [rng.uniform(-limit, limit, 2000) for limit in (1.0, 10.0, 1e3, 1e5)]
    quarter_turns = rng.integers(-60_000, 60_000, 4_000) * (np.pi / 2)
    near_sixths = quarter_turns + rng.choice([-1.0, 1.0], 4_000) * rng.uniform(0.49, 0.55, 4_000)
    return np.concatenate([*everywhere, quarter_turns[quarter_turns != 0.0], near_sixths, [1e5, -1e5]])


def test_sine_and_cosine_are_within_two_ulp_up_to_1e5() -> None:
    assert largest_error(lambda x: sincos(x)[0], mpmath.sin, angles()) <= 2.0
    assert largest_error(lambda x: sincos(x)[1], mpmath.cos, angles()) <= 2.0


def test_arcsine_is_within_two_ulp() -> None:
    rng = np.random.default_rng(0)
    uniform, near_branch = rng.uniform(0.0, 1.0, 4000), rng.uniform(0.49, 0.55, 8000)
    x = np.concatenate([uniform, near_branch, np.geomspace(1e-300, 1.0, 1000), 1.0 - np.geomspace(1e-16, 0.1, 1000)])
    assert largest_error(arcsin, mpmath.asin, x) <= 2.0


def test_arctangent_is_within_two_ulp_in_every_quadrant() -> None:
    """The angles are near the branches too: at the axes, at tan = 0.66, 1 and their inverses."""
    rng = np.random.default_rng(0)
    branches = rng.choice([0.0, np.arctan(0.66), np.pi / 4, np.arctan(1 / 0.66), np.pi / 2], 3000)
    near = branches + rng.choice([-1.0, 1.0], 3000) * np.geomspace(1e-16, 0.1, 3000)
    angle = np.concatenate([rng.uniform(-np.pi, np.pi, 3000), near, np.pi - near, -near])
    size = np.exp(rng.uniform(-50.0, 50.0, angle.size))
    for y, x in zip((size * np.sin(angle)).tolist(), (size * np.cos(angle)).tolist(), strict=True):
        exact = mpmath.atan2(y, x)
        assert abs(mpmath.mpf(arctan2(y, x)) - exact) <= 2.0 * np.spacing(abs(float(exact)))


def test_logarithm_is_within_two_ulp() -> None:
    rng = np.random.default_rng(0)
    near_one, normal = rng.uniform(0.5, 2.0, 4000), np.exp(rng.uniform(-708.0, 709.0, 4000))
    near_branches = np.sqrt(0.5) * 2.0 ** rng.integers(-50, 51, 500) * (1.0 + 1e-9 * rng.normal(size=500))
    x = np.concatenate([near_one, normal, near_branches, 1.0 + np.geomspace(1e-15, 1e-2, 500), [np.finfo(float).tiny]])
    assert largest_error(log, mpmath.log, x[x != 1.0]) <= 2.0
