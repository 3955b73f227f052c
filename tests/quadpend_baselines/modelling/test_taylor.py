"""Truncated Taylor series: every function against derivatives by sympy, and algebraic identities."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from quadpend_baselines.modelling import taylor
from quadpend_gym.core.arrays import Floats

ORDER = 6
t = sp.Symbol("t")
# Each has one function of time per row; all are positive at t = AT.
F, G = (sp.exp(t / 2) + t**3, 2 + sp.sin(3 * t)), (1 + t**2, sp.cosh(t) + t / 3)
AT = sp.Rational(3, 10)


def exact_series(functions: tuple[sp.Expr, ...], order: int = ORDER) -> Floats:
    """Return the series from derivatives by sympy, shape (order + 1, rows)."""
    return taylor.from_derivatives(*exact_derivatives(functions, order))


def exact_derivatives(functions: tuple[sp.Expr, ...], order: int = ORDER) -> Floats:
    """Return the derivatives by sympy, shape (order + 1, rows)."""
    return np.array([[float(sp.diff(f, t, i).subs(t, AT).evalf()) for f in functions] for i in range(order + 1)])


FUNCTIONS: dict[str, tuple[Callable[[Floats, Floats], Floats], Callable[[Any, Any], Any]]] = {
    "product": (taylor.product, lambda f, g: f * g),
    "quotient": (taylor.quotient, lambda f, g: f / g),
    "inverse square root": (lambda f, g: taylor.power(f, -0.5), lambda f, g: f ** sp.Rational(-1, 2)),
    "power": (lambda f, g: taylor.power(g, 3.7), lambda f, g: g ** sp.Rational(37, 10)),
    "arctangent": (lambda f, g: taylor.arctangent(f), lambda f, g: sp.atan(f)),
    "sine": (lambda f, g: taylor.sine_and_cosine(f)[0], lambda f, g: sp.sin(f)),
    "cosine": (lambda f, g: taylor.sine_and_cosine(f)[1], lambda f, g: sp.cos(f)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_agrees_with_sympy(name: str) -> None:
    of_series, of_symbols = FUNCTIONS[name]
    actual = of_series(exact_series(F), exact_series(G))
    assert actual.shape == (ORDER + 1, 2)
    expected = exact_derivatives(tuple(of_symbols(f, g) for f, g in zip(F, G, strict=True)))
    assert_allclose(taylor.to_derivatives(actual), expected, rtol=1e-11, atol=1e-10)
