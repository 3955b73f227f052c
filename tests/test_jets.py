"""Truncated Taylor series: every function against derivatives by sympy, and the algebra that binds them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from baselines import jets
from quadpend_gym.arrays import Floats

ORDER = 6
t = sp.Symbol("t")
# One function of time for each of two rows, all positive at AT.
F, G = (sp.exp(t / 2) + t**3, 2 + sp.sin(3 * t)), (1 + t**2, sp.cosh(t) + t / 3)
AT = sp.Rational(3, 10)


def true_jet(functions: tuple[sp.Expr, ...], order: int = ORDER) -> Floats:
    """Derivatives by sympy as a jet of shape (order + 1, rows)."""
    return jets.jet(*true_derivatives(functions, order))


def true_derivatives(functions: tuple[sp.Expr, ...], order: int = ORDER) -> Floats:
    """Derivatives by sympy, shape (order + 1, rows)."""
    return np.array([[float(sp.diff(f, t, i).subs(t, AT).evalf()) for f in functions] for i in range(order + 1)])


FUNCTIONS: dict[str, tuple[Callable[[Floats, Floats], Floats], Callable[[Any, Any], Any]]] = {
    "product": (jets.product, lambda f, g: f * g),
    "quotient": (jets.quotient, lambda f, g: f / g),
    "inverse square root": (lambda f, g: jets.power(f, -0.5), lambda f, g: f ** sp.Rational(-1, 2)),
    "power": (lambda f, g: jets.power(g, 3.7), lambda f, g: g ** sp.Rational(37, 10)),
    "arctangent": (lambda f, g: jets.arctangent(f), lambda f, g: sp.atan(f)),
    "sine": (lambda f, g: jets.sine_and_cosine(f)[0], lambda f, g: sp.sin(f)),
    "cosine": (lambda f, g: jets.sine_and_cosine(f)[1], lambda f, g: sp.cos(f)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_has_the_derivatives_that_sympy_finds(name: str) -> None:
    of_jets, of_symbols = FUNCTIONS[name]
    actual = of_jets(true_jet(F), true_jet(G))
    assert actual.shape == (ORDER + 1, 2)
    wanted = true_derivatives(tuple(of_symbols(f, g) for f, g in zip(F, G, strict=True)))
    assert_allclose(jets.derivatives(actual), wanted, rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("order", [0, 1, 2, 6])
def test_the_derivative_is_as_many_orders_shorter(order: int) -> None:
    actual = jets.derivatives(jets.derivative(true_jet(F), order))
    assert_allclose(actual, true_derivatives(F)[order:], rtol=1e-13)


@pytest.mark.parametrize("combine", [jets.product, jets.quotient])
def test_two_jets_meet_at_the_lower_order(combine: Callable[[Floats, Floats], Floats]) -> None:
    whole = combine(true_jet(F), true_jet(G))
    assert_allclose(combine(true_jet(F, 3), true_jet(G)), whole[:4], rtol=1e-14)
    assert_allclose(combine(true_jet(F), true_jet(G, 2)), whole[:3], rtol=1e-14)
    assert_allclose(combine(true_jet(F, 0), true_jet(G)), whole[:1], rtol=1e-14)


@pytest.mark.parametrize("combine", [jets.product, jets.quotient])
def test_vectors_take_scalars_on_their_right(combine: Callable[[Floats, Floats], Floats]) -> None:
    vector, scalar = np.stack([true_jet(F), true_jet(G)], axis=-1), true_jet(G)
    actual = combine(vector, scalar[..., np.newaxis])
    for component in range(2):
        assert_allclose(actual[..., component], combine(vector[..., component], scalar), rtol=1e-14)


def test_a_constant_has_no_rate() -> None:
    value = np.array([[1.0, -2.0], [3.0, 0.5]])
    assert_allclose(jets.derivatives(jets.constant(value, 3)), [value, *np.zeros((3, 2, 2))])


def test_nothing_changes_its_arguments() -> None:
    f, g = true_jet(F), true_jet(G)
    for of_jets, _ in FUNCTIONS.values():
        of_jets(f, g)
    assert_allclose(f, true_jet(F), rtol=0.0)
    assert_allclose(g, true_jet(G), rtol=0.0)


small = arrays(np.float64, (ORDER + 1, 3), elements=st.floats(-1.0, 1.0, allow_subnormal=False))
settled = settings(deadline=None, max_examples=60)


@settled
@given(a=small, b=small, c=small)
def test_products_form_a_ring_and_quotients_undo_them(a: Floats, b: Floats, c: Floats) -> None:
    assert_allclose(jets.product(a, b), jets.product(b, a), atol=1e-13)
    assert_allclose(jets.product(a, b + c), jets.product(a, b) + jets.product(a, c), atol=1e-13)
    assert_allclose(jets.product(jets.product(a, b), c), jets.product(a, jets.product(b, c)), atol=1e-12)
    b[0] = 2.0 + b[0]  # away from zero
    assert_allclose(jets.quotient(jets.product(a, b), b), a, atol=1e-9)


@settled
@given(a=small)
def test_the_rules_of_calculus_hold(a: Floats) -> None:
    sine, cosine = jets.sine_and_cosine(a)
    assert_allclose(jets.product(sine, sine) + jets.product(cosine, cosine), jets.constant(np.ones(3), 6), atol=1e-11)
    angle = 0.5 * a
    sine, cosine = jets.sine_and_cosine(angle)
    assert_allclose(jets.arctangent(jets.quotient(sine, cosine)), angle, atol=1e-9)
    a[0] = 2.0 + a[0]
    assert_allclose(jets.power(jets.power(a, 0.5), 2.0), a, atol=1e-11)
    assert_allclose(jets.power(a, -1.0), jets.quotient(jets.constant(np.ones(3), 6), a), atol=1e-9)


def test_a_jet_of_order_zero_is_a_number() -> None:
    a = np.array([[0.3, -0.2]])
    np.testing.assert_array_equal(jets.arctangent(a), np.arctan(a))
    np.testing.assert_array_equal(jets.sine_and_cosine(a), (np.sin(a), np.cos(a)))
    np.testing.assert_array_equal(jets.product(a, a), a * a)
    np.testing.assert_array_equal(jets.quotient(a, a), np.ones_like(a))
