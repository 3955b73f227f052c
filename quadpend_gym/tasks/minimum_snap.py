"""Minimum-snap splines: smooth curves through given points at given times.

A piece is a polynomial of degree 13 in u = (t − tᵢ)/hᵢ, hᵢ = tᵢ₊₁ − tᵢ. Its values and its derivatives of order 1 to 6
at both ends determine it:

    (1)  p(u) = Σ cₖ uᵏ,    c = B d,    d = (p(0), p′(0), …, p⁽⁶⁾(0), p(1), p′(1), …, p⁽⁶⁾(1))

Neighbouring pieces share the derivatives x with respect to time at the point between them, dⱼ = hᵢʲ xⱼ, so the
derivatives of order 0 to 6 are continuous. The observation and the state that follows a reference need these orders.
The spline is the one with the smallest integral of the squared snap, the fourth derivative:

    (2)  J = Σ ∫ (d⁴p/dt⁴)² dt = Σ hᵢ⁻⁷ dᵢᵀ Q dᵢ,    Q = Bᵀ G B,    Gₖₗ = ∫₀¹ (uᵏ)⁗ (uˡ)⁗ du
    (3)  ∂J/∂x = 0 for the derivatives that are not given

The derivatives at the first and the last point are zero; in a closed spline both points are the same one, and its
derivatives are free as well. A spline of degree 7, the usual choice, cannot begin at rest in the derivatives of order 4
to 6. Minimising a higher derivative instead gives larger swings between the points.
"""

from fractions import Fraction
from math import perm

import numpy as np
from scipy.linalg import solve

from quadpend_gym.core.arrays import Floats
from quadpend_gym.tasks.references import ORDERS

COEFFICIENTS = 2 * ORDERS  # of a piece
_SNAP = 4  # order of the derivative whose square is minimised


_ENDS = [[perm(k, j) * u ** max(k - j, 0) for k in range(COEFFICIENTS)] for u in (0, 1) for j in range(ORDERS)]
# B, whose elements are multiples of 1/6!
_EXACT = np.array([[Fraction(round(720.0 * value), 720) for value in row] for row in np.linalg.inv(_ENDS)])
_COEFFICIENTS: Floats = _EXACT.astype(np.float64)
_FACTORS = [perm(k, _SNAP) for k in range(COEFFICIENTS)]
_GRAM = [
    [Fraction(a * b, max(i + j - 2 * _SNAP + 1, 1)) for j, b in enumerate(_FACTORS)] for i, a in enumerate(_FACTORS)
]  # G
# Q loses five digits in floating point, and other ones on each processor, so it is computed with fractions.
_COST = (_EXACT.T @ np.array(_GRAM) @ _EXACT).astype(np.float64)


def minimum_snap(times: Floats, points: Floats, closed: bool) -> Floats:
    """Return the coefficients of the powers of t − tᵢ of the pieces of a minimum-snap spline, shape (m, c, 14).

    The points have the shape (m + 1, c). If the spline is closed, the last one equals the first.
    """
    h = np.diff(times)
    pieces = len(h)
    scale = h[:, np.newaxis] ** np.tile(np.arange(ORDERS), 2)  # hᵢʲ
    point_of_piece = np.column_stack([np.arange(pieces), np.arange(1, pieces + 1)])
    if closed:
        point_of_piece[-1, 1] = 0
    unknowns = (point_of_piece[:, :, np.newaxis] * ORDERS + np.arange(ORDERS)).reshape(pieces, COEFFICIENTS)
    hessian = np.zeros((ORDERS * len(times), ORDERS * len(times)))
    for i in range(pieces):  # (2)
        hessian[np.ix_(unknowns[i], unknowns[i])] += np.outer(scale[i], scale[i]) * _COST / h[i] ** 7
    derivatives = np.zeros((len(times), ORDERS, points.shape[1]))
    derivatives[:, 0] = points
    flat = derivatives.reshape(-1, points.shape[1])
    free_points = np.arange(0 if closed else 1, pieces)
    free = (free_points[:, np.newaxis] * ORDERS + np.arange(1, ORDERS)).ravel()
    if free.size:  # (3), with unknowns scaled so that the diagonal is 1
        unit = 1.0 / np.sqrt(np.diag(hessian)[free])
        matrix = hessian[np.ix_(free, free)] * np.outer(unit, unit)
        flat[free] = unit[:, np.newaxis] * solve(matrix, -unit[:, np.newaxis] * (hessian[free] @ flat), assume_a="pos")
    ends = flat[unknowns] * scale[..., np.newaxis]
    coefficients = np.einsum("kj,ijc->ick", _COEFFICIENTS, ends)
    return np.asarray(coefficients / h[:, np.newaxis, np.newaxis] ** np.arange(COEFFICIENTS))
