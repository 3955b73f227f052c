"""The paper's observers and the algebra of its Theorem 1: (13)–(15), (20)–(22), (46)–(50), (53), (54), (60), λ₀.

A test named `…_as_printed` shows that the printed equation is correct. Every other test shows that the printed form is
wrong and the corrected form holds. test_convergence.py proves the results that replace Theorem 1.
"""

from collections.abc import Sequence

import numpy as np
import pytest
import sympy as sp

from quadpend_baselines.estimation.observers import characteristic_polynomial
from quadpend_baselines.gains import ObserverGains
from tests.helpers.symbolic import (
    FORCE_ON_BOB,
    FORCE_ON_QUADROTOR,
    I_phi,
    I_theta,
    K,
    M,
    g,
    length,
    linearise,
    m_c,
    phi,
    r_x,
    r_y,
    tau_phi,
    tau_theta,
    theta,
    vanishes,
)

S = sp.Symbol("s")
L0, L1, L2, L3, RHO = sp.symbols("lambda_0 lambda_1 lambda_2 lambda_3 rho", positive=True)
TRUE, ESTIMATE, ERROR = (sp.symbols(f"{name}1:5") for name in ("x", "h", "e"))  # xᵢ, x̂ᵢ, ẽᵢ = xᵢ − x̂ᵢ
INPUT, SIGN = sp.symbols("u_known sign", real=True)  # the known input, and sign(ẽ₁)
VARTHETA_DDOT = sp.Symbol("vartheta''")
E1, E2, E3, E4 = ERROR
h1, h2, h3, h4 = ESTIMATE

# The observed plants: (12), (17), (38), (45) with x₃ = ϑ, x₄ = ϑ̇; and F, Ḟ, F̈, F⁽³⁾ with the input F⁽⁴⁾.
DISTURBED_PLANT = (TRUE[1], INPUT + TRUE[2], TRUE[3], VARTHETA_DDOT)
FLAT_PLANT = (TRUE[1], TRUE[2], TRUE[3], INPUT)
# Right-hand sides as printed in (13), (20) and (47), and in (46) except for its last line.
DESO = (h2 + L3 * E1, INPUT + h3 + L2 * E1, h4 + L1 * E1, RHO * SIGN)
LUENBERGER = (h2 + L3 * E1, h3 + L2 * E1, h4 + L1 * E1, INPUT + L0 * E1)
LUENBERGER_PRINTED = (*LUENBERGER[:3], INPUT + L0 * E4)  # λ₀(F₄ − F̂₄)


def error_derivatives(plant: Sequence[sp.Expr], observer: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Return ẽ₁ and its derivatives up to order 4; each line of the observer is a time derivative."""
    known = {true: estimate + error for true, estimate, error in zip(TRUE, ESTIMATE, ERROR, strict=True)}
    rates = [sp.expand(line.subs(known) - guess) for line, guess in zip(plant, observer, strict=True)]
    derivatives = [E1]
    for _ in range(4):
        last = derivatives[-1]
        derivatives.append(sp.expand(sum(sp.diff(last, e) * rate for e, rate in zip(ERROR, rates, strict=True))))
    assert not any(d.has(*ESTIMATE) for d in derivatives)
    return derivatives


def test_14_and_49_as_printed() -> None:
    """They follow from (13) and (47): ẽ⁽⁴⁾ + λ₃ẽ⁽³⁾ + λ₂ẽ̈ + λ₁ẽ̇ + ρ sign(ẽ) = ϑ̈."""
    d = error_derivatives(DISTURBED_PLANT, DESO)
    assert vanishes(d[4] + L3 * d[3] + L2 * d[2] + L1 * d[1] + RHO * SIGN - VARTHETA_DDOT)


def test_21_indices() -> None:
    """The printed (21) has λ₂, λ₁, λ₀ where (20) and (22) give λ₃, λ₂, λ₁."""
    d = error_derivatives(DISTURBED_PLANT, DESO)
    assert not vanishes(d[4] + L2 * d[3] + L1 * d[2] + L0 * d[1] + RHO * SIGN - VARTHETA_DDOT)


@pytest.mark.parametrize("lines", [DESO, LUENBERGER], ids=["13 and 47", "46"])
def test_13_46_and_47_need_their_dots(lines: Sequence[sp.Expr]) -> None:
    """A constant output without estimation error is an equilibrium with the dots and a contradiction without them."""
    output = sp.Symbol("y", positive=True)
    estimate = dict(zip(ESTIMATE, (output, 0, 0, 0), strict=True))
    right_sides = [line.subs({INPUT: 0, SIGN: 0, E1: 0} | estimate) for line in lines]
    assert right_sides == [0, 0, 0, 0]
    assert [estimate[h] - side for h, side in zip(ESTIMATE, right_sides, strict=True)] == [output, 0, 0, 0]


def test_46_last_line_and_48() -> None:
    """λ₀(F₁ − F̂₁) gives (48). The printed λ₀(F₄ − F̂₄) requires a measurement of F⁽³⁾ and gives other dynamics."""
    d = error_derivatives(FLAT_PLANT, LUENBERGER)
    assert vanishes(d[4] + L3 * d[3] + L2 * d[2] + L1 * d[1] + L0 * d[0])
    d = error_derivatives(FLAT_PLANT, LUENBERGER_PRINTED)
    assert not vanishes(d[4] + L3 * d[3] + L2 * d[2] + L1 * d[1] + L0 * d[0])
    matrix = sp.Matrix([[-L3, 1, 0, 0], [-L2, 0, 1, 0], [-L1, 0, 0, 1], [0, 0, 0, -L0]])
    assert vanishes(matrix.charpoly(S).as_expr() - (S + L0) * (S**3 + L3 * S**2 + L2 * S + L1))


def test_47_u_f() -> None:
    """The paper does not define u_F; F̈₅ in (38) and (45) is −gKτθ/Iθ + K F_x⁽⁴⁾ and gKτφ/Iφ + K F_y⁽⁴⁾."""
    chain = linearise()
    calm = dict.fromkeys([*FORCE_ON_QUADROTOR, *FORCE_ON_BOB], 0)
    for fourth, known in (
        (g * K * (r_x - theta), -g * K / I_theta * tau_theta),
        (g * K * (r_y + phi), g * K / I_phi * tau_phi),
    ):
        assert vanishes(chain.derivative(fourth, 2).subs(calm) - (known + K * fourth))


def test_47_u_f_must_contain_what_51_cancels() -> None:
    """Without K F⁽⁴⁾ in u_F, the estimate would contain that term as well, and (51) would subtract it twice."""
    fourth, demanded, disturbance = sp.symbols("F4 v0 vartheta")
    A = M * length * I_theta / ((M + m_c) * g**2)

    def sixth(estimate: sp.Expr) -> sp.Expr:
        torque = -A * (demanded - estimate) + I_theta / g * fourth  # (51) corrected
        return sp.expand(-g * K / I_theta * torque + K * fourth + disturbance)

    assert vanishes(sixth(disturbance) - demanded)
    assert vanishes(sixth(disturbance + K * fourth) - (demanded - K * fourth))


def test_observer_gains_as_printed() -> None:
    """λ₁, λ₂, λ₃ of Section 5 are those of (s² + 2ζωs + ω²)², and λ₀ = ω⁴ (printed ω²) completes it."""
    w, zeta = sp.symbols("omega zeta", positive=True)
    _, third, second, first, zeroth = sp.Poly((S**2 + 2 * zeta * w * S + w**2) ** 2, S).all_coeffs()
    assert vanishes(third - 4 * zeta * w)
    assert vanishes(second - (4 * zeta**2 * w**2 + 2 * w**2))
    assert vanishes(first - 4 * zeta * w**3)
    assert vanishes(zeroth - w**4)
    assert not vanishes(zeroth - w**2)


def test_lambda_0_printed_leaves_a_pole_at_the_origin_almost() -> None:
    """With λ₀ = ω² the Luenberger stage has a pole at −1/(4ζω) = −5.6e-4 rad/s and settles in half an hour."""
    right = characteristic_polynomial(ObserverGains(500.0, 0.9))
    printed = [*right[:4], 500.0**2]
    assert np.max(np.roots(right).real) == pytest.approx(-450.0, rel=1e-4)
    assert np.max(np.roots(printed).real) == pytest.approx(-1.0 / (4.0 * 0.9 * 500.0), rel=1e-3)
    assert np.max(np.roots(printed).real) == pytest.approx(-5.6e-4, rel=0.01)


# e = (ẽ, ẽ̇, ẽ̈, ẽ⁽³⁾) of (53), with the printed A_e and b
A_E = sp.Matrix([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, -L1, -L2, -L3]])
B_E = sp.Matrix([0, 0, 0, 1])


def test_53_second_derivative_of_the_disturbance() -> None:
    """The input of (14), (21) and (49) is ϑ̈. (53) prints ϑ̇, and the sign of a vector instead of its first entry."""
    d = error_derivatives(DISTURBED_PLANT, DESO)
    phase = sp.Matrix(d[:4])
    assert vanishes(sp.Matrix(d[1:]) - (A_E * phase + B_E * (VARTHETA_DDOT - RHO * SIGN)))
    vartheta_dot = sp.Symbol("vartheta'")
    assert not vanishes(sp.Matrix(d[1:]) - (A_E * phase + B_E * (vartheta_dot - RHO * SIGN)))


def test_54_has_no_solution() -> None:
    """A_e e₁ = 0, so e₁ᵀ(A_eᵀP + P A_e)e₁ = 0 for every P, while −e₁ᵀQe₁ < 0 for every Q > 0."""
    P = sp.Matrix(4, 4, lambda i, j: sp.Symbol(f"p{min(i, j)}{max(i, j)}"))
    first = sp.Matrix([1, 0, 0, 0])
    assert A_E.det() == 0
    assert (A_E * first).is_zero_matrix
    assert (first.T * (A_E.T * P + P * A_E) * first)[0].expand() == 0


def test_57_drops_a_term_of_either_sign() -> None:
    """ẽᵀPb ρ sign(ẽ₁) is not ‖ẽ‖‖P‖ρ: for any P with p₄₄ > 0 it has both signs in the half space ẽ₁ > 0."""
    P = sp.Matrix(4, 4, lambda i, j: sp.Symbol(f"p{min(i, j)}{max(i, j)}"))
    e4, p14, p44 = sp.Symbol("e4", real=True), P[0, 3], P[3, 3]
    term = (sp.Matrix([1, 0, 0, e4]).T * P * B_E)[0]  # ẽ₁ = 1, so the sign is +1
    assert vanishes(term - (p14 + p44 * e4))
    for side in (1, -1):
        assert vanishes(term.subs(e4, (side - p14) / p44) - side)


def test_60_misses_a_row() -> None:
    """The printed 3 × 4 matrix lacks the row [0 0 0 1]; with this row it has the polynomial (50)."""
    last = [-L0, -L1, -L2, -L3]
    printed = sp.Matrix([[0, 1, 0, 0], [0, 0, 1, 0], last])
    right = sp.Matrix([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], last])
    errors = sp.Matrix(ERROR)
    assert (printed * errors).shape != errors.shape
    assert vanishes(right.charpoly(S).as_expr() - (S**4 + L3 * S**3 + L2 * S**2 + L1 * S + L0))


def test_15_22_and_50_are_not_those_of_the_sign_term() -> None:
    """They contain a λ₀ that (13), (20) and (47) do not; it appears when sat(ẽ/δ) with δ = ρ/λ₀ replaces sign(ẽ)."""
    d = error_derivatives(DISTURBED_PLANT, tuple(line.subs(SIGN, E1 * L0 / RHO) for line in DESO))
    assert vanishes(d[4] + L3 * d[3] + L2 * d[2] + L1 * d[1] + L0 * d[0] - VARTHETA_DDOT)
    assert vanishes(A_E.charpoly(S).as_expr() - S * (S**3 + L3 * S**2 + L2 * S + L1))
