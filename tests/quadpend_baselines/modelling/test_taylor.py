"""Taylor series: every function against derivatives by sympy."""

from collections.abc import Callable
from math import factorial
from typing import Any

import pytest
import sympy as sp
from numpy.testing import assert_allclose

from quadpend_baselines.modelling import taylor
from quadpend_baselines.modelling.taylor import Series

t = sp.Symbol("t")
# Functions of time, positive at t = AT
PAIRS = [(sp.exp(t / 2) + t**3, 2 + sp.sin(3 * t)), (1 + t**2, sp.cosh(t) + t / 3)]
AT = sp.Rational(3, 10)


def exact_derivatives(function: sp.Expr) -> list[float]:
    """Return the derivatives of order 0 … 4 by sympy."""
    return [float(sp.diff(function, t, i).subs(t, AT).evalf()) for i in range(5)]


FUNCTIONS: dict[str, tuple[Callable[[Series, Series], Series], Callable[[Any, Any], Any]]] = {
    "product": (taylor.product, lambda f, g: f * g),
    "quotient": (taylor.quotient, lambda f, g: f / g),
    "inverse square root": (lambda f, g: taylor.inverse_root(f), lambda f, g: f ** sp.Rational(-1, 2)),
    "arctangent": (lambda f, g: taylor.arctangent(f), lambda f, g: sp.atan(f)),
    "sine": (lambda f, g: taylor.sincos_series(f)[0], lambda f, g: sp.sin(f)),
    "cosine": (lambda f, g: taylor.sincos_series(f)[1], lambda f, g: sp.cos(f)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("pair", PAIRS)
def test_every_function_agrees_with_sympy(name: str, pair: tuple[sp.Expr, sp.Expr]) -> None:
    of_series, of_symbols = FUNCTIONS[name]
    actual = of_series(*(taylor.from_derivatives(*exact_derivatives(f)) for f in pair))
    derivatives = [factorial(i) * c for i, c in enumerate(actual)]
    assert_allclose(derivatives, exact_derivatives(of_symbols(*pair)), rtol=1e-11, atol=1e-10)
