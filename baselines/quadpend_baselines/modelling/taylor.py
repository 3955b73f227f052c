"""Arithmetic of Taylor series of order 4, which propagates derivatives, inside compiled functions.

A series has the Taylor coefficients c_i = f⁽ⁱ⁾(t)/i! of f(t + τ) = Σ c_i τⁱ. A coefficient of a result depends only on
coefficients of the same and of lower orders, so a series that is known to a lower order gives results that are right to
this order. The compiler leaves out the coefficients that nothing uses.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.elementary import arctan2, sincos
from quadpend_gym.core.jit import inlined


class Series(NamedTuple):
    """The coefficients c₀ … c₄."""

    a: float
    b: float
    c: float
    d: float
    e: float


class Pair(NamedTuple):
    """The components of a horizontal vector."""

    x: Series
    y: Series


class Triple(NamedTuple):
    """The components of a vector."""

    x: Series
    y: Series
    z: Series


@inlined
def from_derivatives(value: float, first: float, second: float, third: float, fourth: float) -> Series:
    """Return the series of a function from its derivatives of order 0 … 4."""
    return Series(value, first, second / 2.0, third / 6.0, fourth / 24.0)


@inlined
def plus(x: Series, y: Series) -> Series:
    """Return the series of x + y."""
    return Series(x.a + y.a, x.b + y.b, x.c + y.c, x.d + y.d, x.e + y.e)


@inlined
def times(factor: float, x: Series) -> Series:
    """Return the series of a multiple of x."""
    return Series(factor * x.a, factor * x.b, factor * x.c, factor * x.d, factor * x.e)


@inlined
def combined(factor: float, x: Triple, other: float, y: Triple) -> Triple:
    """Return the sum of multiples of two vectors."""
    return Triple(
        plus(times(factor, x.x), times(other, y.x)),
        plus(times(factor, x.y), times(other, y.y)),
        plus(times(factor, x.z), times(other, y.z)),
    )


@inlined
def shift(number: float, x: Series) -> Series:
    """Return the series of x plus a constant."""
    return Series(number + x.a, x.b, x.c, x.d, x.e)


@inlined
def derivative(x: Series) -> Series:
    """Return the series of ẋ, which is known to one order less: its coefficient c₄ is 0."""
    return Series(x.b, 2.0 * x.c, 3.0 * x.d, 4.0 * x.e, 0.0)


@inlined
def product(x: Series, y: Series) -> Series:
    """Return the series of x y."""
    return Series(
        x.a * y.a,
        x.a * y.b + x.b * y.a,
        x.a * y.c + x.b * y.b + x.c * y.a,
        x.a * y.d + x.b * y.c + x.c * y.b + x.d * y.a,
        x.a * y.e + x.b * y.d + x.c * y.c + x.d * y.b + x.e * y.a,
    )


@inlined
def quotient(x: Series, y: Series) -> Series:
    """Return the series of x / y."""
    a = x.a / y.a
    b = (x.b - a * y.b) / y.a
    c = (x.c - a * y.c - b * y.b) / y.a
    d = (x.d - a * y.d - b * y.c - c * y.b) / y.a
    e = (x.e - a * y.e - b * y.d - c * y.c - d * y.b) / y.a
    return Series(a, b, c, d, e)


@inlined
def inverse_root(x: Series) -> Series:
    """Return the series of 1/√x; x must be positive."""
    a = 1.0 / np.sqrt(x.a)
    b = -0.5 * x.b * a / x.a
    c = -(1.5 * x.b * b + x.c * a) / (2.0 * x.a)
    d = -(2.5 * x.b * c + 2.0 * x.c * b + 1.5 * x.d * a) / (3.0 * x.a)
    e = -(3.5 * x.b * d + 3.0 * x.c * c + 2.5 * x.d * b + 2.0 * x.e * a) / (4.0 * x.a)
    return Series(a, b, c, d, e)


@inlined
def arctangent(x: Series) -> Series:
    """Return the series of arctan x."""
    rate = quotient(derivative(x), shift(1.0, product(x, x)))
    return Series(arctan2(x.a, 1.0), rate.a, rate.b / 2.0, rate.c / 3.0, rate.d / 4.0)


@inlined
def sincos_series(x: Series) -> tuple[Series, Series]:
    """Return the series of sin x and of cos x."""
    sa, ca = sincos(x.a)
    sb, cb = x.b * ca, -x.b * sa
    sc, cc = (x.b * cb + 2.0 * x.c * ca) / 2.0, -(x.b * sb + 2.0 * x.c * sa) / 2.0
    sd = (x.b * cc + 2.0 * x.c * cb + 3.0 * x.d * ca) / 3.0
    cd = -(x.b * sc + 2.0 * x.c * sb + 3.0 * x.d * sa) / 3.0
    se = (x.b * cd + 2.0 * x.c * cc + 3.0 * x.d * cb + 4.0 * x.e * ca) / 4.0
    ce = -(x.b * sd + 2.0 * x.c * sc + 3.0 * x.d * sb + 4.0 * x.e * sa) / 4.0
    return Series(sa, sb, sc, sd, se), Series(ca, cb, cc, cd, ce)
