"""Arithmetic of truncated Taylor series, which propagates derivatives of any order.

A series is an array of shape (k + 1, …) with the Taylor coefficients c_i = f⁽ⁱ⁾(t)/i! of f(t + τ) = Σ c_i τⁱ for
i = 0 … k, where k is the order of the series. No function changes its arguments.
"""

from math import factorial

import numpy as np

from quadpend_gym.core.arrays import Floats


def from_derivatives(*derivatives: Floats) -> Floats:
    """Return the series of a function from its derivatives of order 0, 1, …, each of shape (…)."""
    return np.stack([d / factorial(i) for i, d in enumerate(derivatives)])


def to_derivatives(a: Floats) -> Floats:
    """Return the derivatives of order 0 … k of a series, shape (k + 1, …)."""
    return np.stack([c * factorial(i) for i, c in enumerate(a)])


def derivative(a: Floats, order: int = 1) -> Floats:
    """Return the series of a derivative; its order is lower by `order`."""
    return np.stack([c * (factorial(i) // factorial(i - order)) for i, c in enumerate(a) if i >= order])


def constant(value: Floats, order: int) -> Floats:
    """Return the series of a constant, truncated after `order`."""
    out = np.zeros((order + 1, *value.shape))
    out[0] = value
    return out


def product(a: Floats, b: Floats) -> Floats:
    """Return the series of a b, truncated after the lower order of the two."""
    out = a[0] * b[: len(a)]
    for i in range(1, len(out)):
        out[i:] += a[i] * b[: len(out) - i]
    return np.asarray(out)


def quotient(a: Floats, b: Floats) -> Floats:
    """Return the series of a / b, truncated after the lower order of the two."""
    out = a[: len(b)] / b[0]
    ratio = b[: len(out)] / b[0]
    for i in range(len(out) - 1):
        out[i + 1 :] -= out[i] * ratio[1 : len(out) - i]
    return np.asarray(out)


def power(a: Floats, exponent: float) -> Floats:
    """Return the series of a to a constant power; a must be positive."""
    out = np.empty_like(a)
    out[0] = a[0] ** exponent
    for k in range(1, len(a)):
        out[k] = 0.0
        for i in range(1, k + 1):
            out[k] += (exponent * i - (k - i)) * a[i] * out[k - i]
        out[k] /= k * a[0]
    return out


def arctangent(a: Floats) -> Floats:
    """Return the series of arctan a."""
    if len(a) == 1:
        return np.arctan(a)
    squared = product(a, a)
    squared[0] += 1.0
    rate = quotient(derivative(a), squared)
    return np.stack([np.arctan(a[0]), *(c / (i + 1) for i, c in enumerate(rate))])


def sine_and_cosine(a: Floats) -> tuple[Floats, Floats]:
    """Return the series of sin a and of cos a."""
    sine, cosine = np.empty_like(a), np.empty_like(a)
    sine[0], cosine[0] = np.sin(a[0]), np.cos(a[0])
    for k in range(1, len(a)):
        sine[k] = cosine[k] = 0.0
        for i in range(1, k + 1):
            sine[k] += i / k * a[i] * cosine[k - i]
            cosine[k] -= i / k * a[i] * sine[k - i]
    return sine, cosine
