"""The paper's linear chain and its control laws, (12), (16), (23)–(45), (51), (52) and (61)–(64).

The oracle is the Euler–Lagrange equations, linearised at hover by sympy. In each of the paper's two planes, its angle α
is the tilt of the pendulum in that plane: r_x in x–z, r_y in y–z.

A test named `…_as_printed` shows that the printed equation is correct. Every other test shows that the printed form is
wrong and the corrected form holds.
"""

import numpy as np
import pytest
import sympy as sp

from quadpend_gym.vehicles import PAPER
from tests.helpers.symbolic import (
    FORCE_ON_BOB,
    FORCE_ON_QUADROTOR,
    I_phi,
    I_psi,
    I_theta,
    K,
    LinearModel,
    M,
    g,
    length,
    linearise,
    m_c,
    phi,
    psi,
    r_x,
    r_y,
    rate_of,
    tau_phi,
    tau_psi,
    tau_theta,
    theta,
    vanishes,
    x,
    y,
    z,
)

CALM = dict.fromkeys([*FORCE_ON_QUADROTOR, *FORCE_ON_BOB], 0)
F_x, F_y = x + length * r_x, y + length * r_y
S = sp.Symbol("s")
V = sp.Symbol("v")  # F_d⁽⁶⁾ − Σ kᵢ eᵢ − ϑ̂
FOURTH = sp.Symbol("F4")  # F⁽⁴⁾
A_theta = M * length * I_theta / ((M + m_c) * g**2)
A_phi = A_theta.subs(I_theta, I_phi)


@pytest.fixture(scope="module")
def chain() -> LinearModel:
    return linearise()


def calm(chain: LinearModel, coordinate: sp.Symbol) -> sp.Expr:
    """Return the acceleration of a coordinate without wind."""
    return chain.acceleration(coordinate).subs(CALM)


def test_12_as_printed(chain: LinearModel) -> None:
    assert vanishes(calm(chain, psi) - tau_psi / I_psi)


def test_24_to_28_as_printed(chain: LinearModel) -> None:
    printed = {
        x: ((M + m_c) * g * theta - m_c * g * r_x) / M,  # (24)
        theta: tau_theta / I_theta,  # (25)
        r_x: K * (r_x - theta),  # (26)
        y: (-(M + m_c) * g * phi - m_c * g * r_y) / M,  # (27)
        phi: tau_phi / I_phi,  # (28)
    }
    for coordinate, expected in printed.items():
        assert vanishes(calm(chain, coordinate) - expected), coordinate


def test_29(chain: LinearModel) -> None:
    """K(α + φ), printed K(φ − α): with φ = 0 this is a hanging pendulum, and no choice of signs makes it inverted."""
    assert vanishes(calm(chain, r_y) - K * (r_y + phi))
    for tilt, roll in ((r_y, phi), (-r_y, phi), (r_y, -phi), (-r_y, -phi)):
        printed = sp.diff(tilt, r_y) * K * (roll - tilt)
        assert not vanishes(calm(chain, r_y) - printed)
        assert sp.diff(printed, r_y) == -K  # α̈ = −Kα: an oscillation
    assert sp.diff(calm(chain, r_y), r_y).equals(K)  # α̈ = Kα: unstable


def test_29_as_printed_contradicts_41(chain: LinearModel) -> None:
    """F̈_y = ÿ + l α̈ = g α, with (27) as printed, requires the corrected (29)."""
    for swing, holds in ((K * (r_y + phi), True), (K * (phi - r_y), False)):
        assert vanishes(calm(chain, y) + length * swing - g * r_y) is holds


def test_30_and_31_need_an_angle_each(chain: LinearModel) -> None:
    """F = x + l r_x, y + l r_y obey F̈ = g r; with one α for both, a pendulum tilted along y would accelerate F_x."""
    assert vanishes(chain.derivative(F_x, 2).subs(CALM) - g * r_x)
    assert vanishes(chain.derivative(F_y, 2).subs(CALM) - g * r_y)
    shared = r_y  # β = π/2: the whole of α lies in the y–z plane, r_x = 0
    printed = chain.derivative(x + length * shared, 2).subs(CALM)
    assert not vanishes(printed - g * shared)
    assert not vanishes(printed.subs(r_x, 0) - g * 0)


def test_30_and_31_corrected_are_exactly_the_bobs_position() -> None:
    bob = sp.Matrix([x, y, z]) + length * sp.Matrix([r_x, r_y, sp.sqrt(1 - r_x**2 - r_y**2)])
    assert bob[:2] == [F_x, F_y]


def test_32_to_38_as_printed(chain: LinearModel) -> None:
    gain = (M + m_c) * g**2 / (M * length)
    fourth = gain * (r_x - theta)
    printed = [
        F_x,  # (32)
        rate_of(x) + length * rate_of(r_x),  # (33)
        g * r_x,  # (34)
        g * rate_of(r_x),  # (35)
        fourth,  # (36)
        gain * (rate_of(r_x) - rate_of(theta)),  # (37)
        -gain / I_theta * tau_theta + (M + m_c) * g / (M * length) * fourth,  # (38)
    ]
    for order, expected in enumerate(printed):
        assert vanishes(chain.derivative(F_x, order).subs(CALM) - expected), order


def test_39_to_42_as_printed(chain: LinearModel) -> None:
    printed = [F_y, rate_of(y) + length * rate_of(r_y), g * r_y, g * rate_of(r_y)]
    for order, expected in enumerate(printed):
        assert vanishes(chain.derivative(F_y, order).subs(CALM) - expected), order


def test_43_and_44(chain: LinearModel) -> None:
    """gK(α + φ) and its derivative, printed gK(φ − α)."""
    fourth, fifth = (chain.derivative(F_y, order).subs(CALM) for order in (4, 5))
    assert vanishes(fourth - g * K * (r_y + phi))
    assert not vanishes(fourth - g * K * (phi - r_y))
    assert vanishes(fifth - g * K * (rate_of(r_y) + rate_of(phi)))
    assert not vanishes(fifth - g * K * (rate_of(phi) - rate_of(r_y)))


def test_45(chain: LinearModel) -> None:
    """I_φ and F_y⁽⁴⁾, printed I_θ and 𝓕⁽⁴⁾; the printed signs are correct but do not follow from the printed (43)."""
    fourth, sixth = (chain.derivative(F_y, order).subs(CALM) for order in (4, 6))
    assert vanishes(sixth - (g * K / I_phi * tau_phi + K * fourth))
    assert not vanishes(sixth - (g * K / I_theta * tau_phi + K * fourth))
    assert not vanishes(sixth - (g * K / I_phi * tau_phi + K * g * K * (phi - r_y)))


def sixth_derivative(torque: sp.Expr, axis: str) -> sp.Expr:
    """Return F⁽⁶⁾ as a function of a torque, by (38) and (45) corrected."""
    gain = {"x": -g * K / I_theta, "y": g * K / I_phi}[axis]
    return sp.expand(gain * torque + K * FOURTH)


def test_51() -> None:
    """τθ = −A v + (I/g) F⁽⁴⁾, printed +A v: this gives F⁽⁶⁾ = −v instead of v, with the wrong sign of every gain."""
    assert vanishes(sixth_derivative(-A_theta * V + I_theta / g * FOURTH, "x") - V)
    assert vanishes(sixth_derivative(A_theta * V + I_theta / g * FOURTH, "x") + V)


def test_52() -> None:
    """τφ = +A v − (I/g) F⁽⁴⁾, printed −A v + (I/g) F⁽⁴⁾: this gives F⁽⁶⁾ = −v + 2K F⁽⁴⁾."""
    assert vanishes(sixth_derivative(A_phi * V - I_phi / g * FOURTH, "y") - V)
    assert vanishes(sixth_derivative(-A_phi * V + I_phi / g * FOURTH, "y") - (-V + 2 * K * FOURTH))


def test_51_and_52_mi_is_m_times_l() -> None:
    """The factor printed as MI in both laws is M·l; with M·I_θ or with M the gain from v to F⁽⁶⁾ is not one."""
    for first in (M * I_theta, M):
        misread = first * I_theta / ((M + m_c) * g**2)
        assert not vanishes(sixth_derivative(-misread * V + I_theta / g * FOURTH, "x") - V)


def feedback_gains(bandwidth: float, damping: float) -> list[float]:
    """Return k₀ … k₅ as printed in Section 5."""
    w, zeta = bandwidth, damping
    return [
        w**6,
        6 * zeta * w**5,
        12 * w**4 * zeta**2 + 3 * w**4,
        8 * w**3 * zeta**3 + 12 * w**3 * zeta,
        12 * w**2 * zeta**2 + 3 * w**2,
        6 * w * zeta,
    ]


def test_laws_as_printed_are_unstable_and_the_corrected_ones_are_not() -> None:
    """Poles of the closed loop with the gains of Section 5: F⁽⁶⁾ = v, −v by (51), and −v + 2K F⁽⁴⁾ by (52)."""
    k = np.array(feedback_gains(7.0, 0.9))[::-1]
    second_term = np.array([0.0, 2.0 * PAPER.chain_stiffness, 0.0, 0.0, 0.0, 0.0])
    right, x_printed, y_printed = (np.roots([1.0, *rest]) for rest in (k, -k, -k - second_term))
    assert np.max(right.real) == pytest.approx(-6.3, abs=1e-3)
    for printed in (x_printed, y_printed):
        assert np.max(printed.real) > 40.0  # 1/s: the pendulum falls in a fraction of a second


def test_feedback_gains_as_printed() -> None:
    """k₀ … k₅ are the coefficients of (s² + 2ζωs + ω²)³, and k₀, k₁ of z and ψ those of s² + 2ζωs + ω²."""
    w, zeta = sp.symbols("omega zeta", positive=True)
    quadratic = S**2 + 2 * zeta * w * S + w**2
    expected = sp.Poly(quadratic**3, S).all_coeffs()[:0:-1]
    assert all(vanishes(a - b) for a, b in zip(feedback_gains(w, zeta), expected, strict=True))
    assert sp.Poly(quadratic, S).all_coeffs() == [1, 2 * zeta * w, w**2]


def test_16_and_23_as_printed_and_61_to_63() -> None:
    """The laws give e⁽ⁿ⁾ + Σ kᵢ e⁽ⁱ⁾ = ϑ − ϑ̂; (61)–(63) print ϑ̂ − ϑ on this side, unlike (64), which is correct."""
    k0, k1, desired, error, error_rate, disturbance, estimate = sp.symbols("k0 k1 a_d e e' vartheta vartheta_hat")
    demanded = desired - k1 * error_rate - k0 * error - estimate
    thrust_gain = sp.Symbol("g_z", positive=True)
    torque, thrust = I_psi * demanded, demanded / thrust_gain  # (16), (23)
    plants = {"(12)": torque / I_psi + disturbance, "(17)": thrust_gain * thrust + disturbance}
    k = sp.symbols("k:6")
    errors = sp.symbols("e:6")
    feedback = sum(a * b for a, b in zip(k, errors, strict=True))
    for name, acceleration in plants.items():
        left = (acceleration - desired) + k1 * error_rate + k0 * error
        assert vanishes(left - (disturbance - estimate)), name
        assert not vanishes(left + (disturbance - estimate)), name
    law = -A_theta * (desired - feedback - estimate) + I_theta / g * FOURTH  # (51) corrected
    left = sixth_derivative(law, "x") + disturbance - desired + feedback
    assert vanishes(left - (disturbance - estimate))
    assert not vanishes(left + (disturbance - estimate))


def test_64_has_n_states_not_n_plus_1() -> None:
    """e = [e, ė, …, e⁽ⁿ⁻¹⁾]ᵀ, printed up to e⁽ⁿ⁾: (65) is of degree n = 2 and has a 2 × 2 matrix A."""
    k0, k1 = sp.symbols("k0 k1")
    A = sp.Matrix([[0, 1], [-k0, -k1]])
    assert vanishes(A.charpoly(S).as_expr() - (S**2 + k1 * S + k0))
    for n in (2, 6):
        printed = [f"e^({i})" for i in range(n + 1)]
        assert len(printed) != n
