"""The paper's printed equations, compared with what sympy derives from its energies; docs/paper.md lists all of them.

In each of the paper's two planes, its angle α is the tilt of the pendulum in that plane: r_x in x–z, r_y in y–z.
`pytest -k "misprint and 29"` proves one erratum.
"""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pytest
import sympy as sp

from quadpend_baselines.estimation.observers import characteristic_polynomial
from quadpend_baselines.gains import ObserverGains
from quadpend_gym.vehicles import PAPER
from tests.helpers.symbolic import (
    COMMAND,
    FORCE_ON_BOB,
    FORCE_ON_QUADROTOR,
    SPHERICAL,
    THRUST_AXIS,
    I_phi,
    I_psi,
    I_theta,
    K,
    M,
    alpha,
    beta,
    derive,
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
    u,
    vanishes,
    x,
    y,
    z,
)

model, chain = cache(lambda: derive(SPHERICAL)), cache(linearise)
POSITION, EULER, PENDULUM = slice(0, 3), slice(3, 6), slice(6, 8)
S_a, C_a, S_b, C_b = sp.sin(alpha), sp.cos(alpha), sp.sin(beta), sp.cos(beta)
S_phi, C_phi, S_th, C_th, S_psi, C_psi = (f(angle) for angle in (phi, theta, psi) for f in (sp.sin, sp.cos))
a_dot, b_dot = rate_of(alpha), rate_of(beta)
SWING = sp.Matrix([a_dot, b_dot])
F_x, F_y = x + length * r_x, y + length * r_y
CALM = dict.fromkeys([*FORCE_ON_QUADROTOR, *FORCE_ON_BOB], 0)


def near_hover(expression: sp.Expr, order: int = 2) -> sp.Expr:
    """Return a time derivative by the linear model, without wind."""
    return chain().derivative(expression, order).subs(CALM)


def swing_force(row: int) -> sp.Expr:
    """Return a row of C (α̇, β̇)ᵀ."""
    return (model().coriolis[:, PENDULUM] * SWING)[row]


@cache
def height_acceleration() -> sp.Expr:
    """Return z̈ of (7), with the accelerations of the pendulum eliminated."""
    full = model()
    couple, swing = full.mass[POSITION, PENDULUM], full.mass[PENDULUM, PENDULUM]
    through = couple * swing.inv()
    force = full.inputs * sp.Matrix(COMMAND) - full.coriolis * full.q_dot - full.gravity
    inverse = (sp.eye(3) - m_c / (M + m_c) * SPHERICAL[1] * SPHERICAL[1].T) / M
    assert vanishes((full.mass[POSITION, POSITION] - through * couple.T) * inverse - sp.eye(3))
    return (inverse * (force[POSITION, :] - through * force[PENDULUM, :]))[2]


def thrust_gain(last: sp.Expr) -> sp.Expr:
    """Return g_z of (18) with a last factor."""
    tilt = (C_psi * S_b - S_psi * C_b) * S_phi - (C_psi * C_b + S_psi * S_b) * S_th * last
    upright = (M + m_c) * C_th * C_phi - m_c * C_a**2 * C_phi * C_th
    return (m_c * tilt * S_a * C_a + upright) / (M * (M + m_c))


# The laws: v = F_d⁽⁶⁾ − Σ kᵢ eᵢ − ϑ̂ and F⁽⁴⁾ in (51), (52), with (38) and (45) corrected
V, FOURTH, DEMANDED, TRUTH, GUESS = sp.symbols("v F4 v0 vartheta vartheta_hat")
A_theta, A_phi = (M * length * inertia / ((M + m_c) * g**2) for inertia in (I_theta, I_phi))


def sixth_x(torque: sp.Expr) -> sp.Expr:
    return sp.expand(-g * K / I_theta * torque + K * FOURTH)


def sixth_y(torque: sp.Expr) -> sp.Expr:
    return sp.expand(g * K / I_phi * torque + K * FOURTH)


def closed_loop(law: sp.Expr) -> sp.Expr:
    """Return e⁽⁶⁾ + Σ kᵢ eᵢ for a law of τθ, in which v = DEMANDED − ϑ̂."""
    return sixth_x(law.subs(V, DEMANDED - GUESS)) + TRUTH - DEMANDED


# The observers: xᵢ, x̂ᵢ, ẽᵢ = xᵢ − x̂ᵢ; their plants (12), (17), (38), (45) with x₃ = ϑ, and F … F⁽³⁾ with the input F⁽⁴⁾
L0, L1, L2, L3, RHO, W, ZETA = sp.symbols("lambda_0 lambda_1 lambda_2 lambda_3 rho omega zeta", positive=True)
TRUE, ESTIMATE, (E1, E2, E3, E4) = (sp.symbols(f"{name}1:5") for name in ("x", "h", "e"))
h1, h2, h3, h4 = ESTIMATE
INPUT, SIGN = sp.symbols("u_known sign", real=True)
S, V_DDOT = sp.symbols("s vartheta''")
DISTURBED_PLANT, FLAT_PLANT = (TRUE[1], INPUT + TRUE[2], TRUE[3], V_DDOT), (TRUE[1], TRUE[2], TRUE[3], INPUT)
DESO = (h2 + L3 * E1, INPUT + h3 + L2 * E1, h4 + L1 * E1, RHO * SIGN)  # (13), (20), (47)
LUENBERGER = (h2 + L3 * E1, h3 + L2 * E1, h4 + L1 * E1, INPUT + L0 * E1)  # (46) corrected
A_E = sp.Matrix([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, -L1, -L2, -L3]])  # (53)
B_E = sp.Matrix([0, 0, 0, 1])
QUADRATIC = S**2 + 2 * ZETA * W * S + W**2


def error_derivatives(plant: Sequence[sp.Expr], observer: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Return ẽ₁ and its derivatives up to order 4; each line of the observer is a time derivative."""
    errors = (E1, E2, E3, E4)
    known = {true: estimate + error for true, estimate, error in zip(TRUE, ESTIMATE, errors, strict=True)}
    rates = [sp.expand(line.subs(known) - guess) for line, guess in zip(plant, observer, strict=True)]
    derivatives = [E1]
    for _ in range(4):
        last = derivatives[-1]
        derivatives.append(sp.expand(sum(sp.diff(last, e) * rate for e, rate in zip(errors, rates, strict=True))))
    return derivatives


def dynamics(derivatives: list[sp.Expr], *gains: sp.Expr) -> sp.Expr:
    """Return ẽ⁽⁴⁾ + Σ λ ẽ⁽ⁱ⁾ with the gains of ẽ⁽³⁾, ẽ̈, …"""
    return derivatives[4] + sum(gain * derivatives[3 - i] for i, gain in enumerate(gains))


DESO_ERRORS, FLAT_ERRORS = error_derivatives(DISTURBED_PLANT, DESO), error_derivatives(FLAT_PLANT, LUENBERGER)
MEASURES_F4 = error_derivatives(FLAT_PLANT, (*LUENBERGER[:3], INPUT + L0 * E4))
SATURATED = error_derivatives(DISTURBED_PLANT, [line.subs(SIGN, E1 * L0 / RHO) for line in DESO])
ml, gain = m_c * length, (M + m_c) * g**2 / (M * length)
known_x, known_y = -g * K / I_theta * tau_theta, g * K / I_phi * tau_phi
fourth_x, fourth_y = g * K * (r_x - theta), g * K * (r_y + phi)

# What is derived, the corrected equation, and the printed one.
MISPRINTS: dict[str, tuple[Callable[[], sp.Expr], sp.Expr, sp.Expr]] = {
    "Theta_31": (lambda: model().mass[2, 6], -ml * S_a, ml * S_a),
    "Gamma_21": (lambda: model().mass[6, 1], ml * C_a * S_b, -ml * C_a * S_b),
    "Y_1": (
        lambda: swing_force(0),
        ml * (sp.Matrix([[-a_dot * S_a * C_b - b_dot * C_a * S_b, -a_dot * C_a * S_b - b_dot * S_a * C_b]]) * SWING)[0],
        ml * (sp.Matrix([[-a_dot * S_a - b_dot * C_a * S_b, -a_dot * C_a * C_b - b_dot * S_a]]) * SWING)[0],
    ),
    "Y_2": (
        lambda: swing_force(1),
        ml * (sp.Matrix([[-a_dot * S_a * S_b + b_dot * C_a * C_b, a_dot * C_a * C_b - b_dot * S_a * S_b]]) * SWING)[0],
        ml * (sp.Matrix([[-a_dot * S_a - b_dot * C_a * C_b, -a_dot * C_a * C_b - b_dot * S_a]]) * SWING)[0],
    ),
    "Psi_2": (
        lambda: swing_force(7),
        ml * length * (sp.Matrix([[b_dot * S_a * C_a, a_dot * S_a * C_a]]) * SWING)[0],
        ml * length * (sp.Matrix([[b_dot * S_a * C_b, a_dot * S_a * C_b]]) * SWING)[0],
    ),
    "18": (lambda: sp.diff(height_acceleration(), u), thrust_gain(C_phi), thrust_gain(C_psi)),
    "21": (lambda: V_DDOT - RHO * SIGN, dynamics(DESO_ERRORS, L3, L2, L1), dynamics(DESO_ERRORS, L2, L1, L0)),
    "29": (lambda: near_hover(r_y), K * (r_y + phi), K * (phi - r_y)),
    "30": (lambda: near_hover(F_x), g * r_x, g * r_y),  # one α for both: a pendulum tilted along y accelerates F_x
    "31": (lambda: near_hover(F_y), g * r_y, g * r_x),
    "43": (lambda: near_hover(F_y, 4), fourth_y, g * K * (phi - r_y)),
    "44": (lambda: near_hover(F_y, 5), g * K * (rate_of(r_y) + rate_of(phi)), g * K * (rate_of(phi) - rate_of(r_y))),
    "45": (lambda: near_hover(F_y, 6), known_y + K * fourth_y, g * K / I_theta * tau_phi + K * fourth_y),
    "46": (lambda: sp.S(0), dynamics(FLAT_ERRORS, L3, L2, L1, L0), dynamics(MEASURES_F4, L3, L2, L1, L0)),
    "47_x": (lambda: near_hover(fourth_x), known_x + K * fourth_x, known_x),  # u_F is not defined
    "47_y": (lambda: near_hover(fourth_y), known_y + K * fourth_y, known_y),
    "51": (lambda: V, sixth_x(-A_theta * V + I_theta / g * FOURTH), sixth_x(A_theta * V + I_theta / g * FOURTH)),
    "51_MI": (
        lambda: V,
        sixth_x(-A_theta * V + I_theta / g * FOURTH),
        sixth_x(-M * I_theta**2 / ((M + m_c) * g**2) * V + I_theta / g * FOURTH),
    ),
    "52": (lambda: V, sixth_y(A_phi * V - I_phi / g * FOURTH), sixth_y(-A_phi * V + I_phi / g * FOURTH)),
    "61_to_63": (lambda: closed_loop(-A_theta * V + I_theta / g * FOURTH), TRUTH - GUESS, GUESS - TRUTH),
    "lambda_0": (lambda: sp.expand(QUADRATIC**2).coeff(S, 0), W**4, W**2),
}


@pytest.mark.parametrize("equation", MISPRINTS)
def test_misprint(equation: str) -> None:
    """The corrected equation is what the model gives, and the printed one is not."""
    derived, corrected, printed = MISPRINTS[equation]
    assert vanishes(derived() - corrected)
    assert not vanishes(derived() - printed)


CORRECT: dict[str, tuple[Callable[[], sp.Expr], sp.Expr]] = {
    "Phi": (lambda: model().mass[PENDULUM, PENDULUM], ml * length * sp.diag(1, S_a**2)),
    "Y_3": (lambda: model().coriolis[2, PENDULUM], ml * sp.Matrix([[-a_dot * C_a, 0]])),
    "Psi_1": (lambda: model().coriolis[6, PENDULUM], ml * length * sp.Matrix([[0, -b_dot * S_a * C_a]])),
    "G": (lambda: model().gravity, sp.Matrix([0, 0, g * (M + m_c), 0, 0, 0, -ml * g * S_a, 0])),
    "B": (
        lambda: model().inputs,
        sp.Matrix(sp.BlockMatrix([[THRUST_AXIS, sp.zeros(3)], [sp.zeros(5, 1), sp.eye(5)[:, :3]]])),
    ),
    "12": (lambda: near_hover(psi), tau_psi / I_psi),
    "14_and_49": (lambda: V_DDOT - RHO * SIGN, dynamics(DESO_ERRORS, L3, L2, L1)),
    "16_and_23": (lambda: closed_loop(-A_theta * V + I_theta / g * FOURTH), TRUTH - GUESS),
    "19": (
        lambda: height_acceleration().subs(u, 0),
        (ml * (b_dot**2 * (C_a - C_a**3) + a_dot**2 * C_a) - (M + m_c) * g) / (M + m_c),
    ),
    "24": (lambda: near_hover(x), ((M + m_c) * g * theta - m_c * g * r_x) / M),
    "25": (lambda: near_hover(theta), tau_theta / I_theta),
    "26": (lambda: near_hover(r_x), K * (r_x - theta)),
    "27": (lambda: near_hover(y), (-(M + m_c) * g * phi - m_c * g * r_y) / M),
    "28": (lambda: near_hover(phi), tau_phi / I_phi),
    "33": (lambda: near_hover(F_x, 1), rate_of(x) + length * rate_of(r_x)),
    "34": (lambda: near_hover(F_x, 2), g * r_x),
    "35": (lambda: near_hover(F_x, 3), g * rate_of(r_x)),
    "36": (lambda: near_hover(F_x, 4), gain * (r_x - theta)),
    "37": (lambda: near_hover(F_x, 5), gain * (rate_of(r_x) - rate_of(theta))),
    "38": (lambda: near_hover(F_x, 6), -gain / I_theta * tau_theta + K * gain * (r_x - theta)),
    "40": (lambda: near_hover(F_y, 1), rate_of(y) + length * rate_of(r_y)),
    "41": (lambda: near_hover(F_y, 2), g * r_y),
    "42": (lambda: near_hover(F_y, 3), g * rate_of(r_y)),
    "48": (lambda: sp.S(0), dynamics(FLAT_ERRORS, L3, L2, L1, L0)),
    "lambda_3": (lambda: sp.expand(QUADRATIC**2).coeff(S, 3), 4 * ZETA * W),
    "lambda_2": (lambda: sp.expand(QUADRATIC**2).coeff(S, 2), 4 * ZETA**2 * W**2 + 2 * W**2),
    "lambda_1": (lambda: sp.expand(QUADRATIC**2).coeff(S, 1), 4 * ZETA * W**3),
}


@pytest.mark.parametrize("equation", CORRECT)
def test_correct_as_printed(equation: str) -> None:
    derived, printed = CORRECT[equation]
    assert vanishes(derived() - printed)


def test_6_and_7_are_the_same_equation_with_a_command_in_r4() -> None:
    """d/dt ∂L/∂q̇ − ∂L/∂q = C q̇ + G; u = [f τ 0 0]ᵀ ∈ R⁸ is right in (6), but B of (7) is 8 × 4."""
    full = model()
    kinetic = (full.q_dot.T * full.mass * full.q_dot)[0] / 2
    potential = (M + m_c) * g * z + ml * g * C_a  # (4) + (5) as printed
    momentum = full.mass * full.q_dot
    bias = momentum.jacobian(full.q) * full.q_dot - sp.Matrix([kinetic - potential]).jacobian(full.q).T
    assert vanishes(full.coriolis * full.q_dot + full.gravity - bias)
    force = sp.Matrix([u * THRUST_AXIS, sp.Matrix(COMMAND[1:]), sp.zeros(2, 1)])
    assert full.inputs.shape == (8, 4)
    assert vanishes(full.inputs * sp.Matrix(COMMAND) - force)


def test_mass_matrix_is_singular_when_the_pendulum_is_upright() -> None:
    """So (α, β) cannot be integrated through the upright position."""
    expected = I_phi * I_theta * I_psi * M**2 * m_c**2 * length**4 * (M + m_c) * S_a**2
    assert vanishes(model().mass.det(method="berkowitz") - expected)


def test_29_as_printed_is_a_hanging_pendulum_for_every_choice_of_signs() -> None:
    for tilt, roll in ((r_y, phi), (-r_y, phi), (r_y, -phi), (-r_y, -phi)):
        printed = sp.diff(tilt, r_y) * K * (roll - tilt)
        assert sp.diff(printed, r_y) == -K  # an oscillation
    assert sp.diff(near_hover(r_y), r_y).equals(K)  # unstable


@pytest.mark.parametrize("lines", [DESO, LUENBERGER], ids=["13 and 47", "46"])
def test_13_46_and_47_need_their_dots(lines: Sequence[sp.Expr]) -> None:
    """A constant output without estimation error is an equilibrium with the dots and a contradiction without them."""
    output = sp.Symbol("y", positive=True)
    estimate = dict(zip(ESTIMATE, (output, 0, 0, 0), strict=True))
    right_sides = [line.subs({INPUT: 0, SIGN: 0, E1: 0} | estimate) for line in lines]
    assert right_sides == [0, 0, 0, 0] != list(estimate.values())


def test_54_has_no_solution() -> None:
    """A_e e₁ = 0, so e₁ᵀ(A_eᵀP + P A_e)e₁ = 0 for every P, while −e₁ᵀQe₁ < 0 for every Q > 0."""
    P = sp.Matrix(4, 4, lambda i, j: sp.Symbol(f"p{min(i, j)}{max(i, j)}"))
    first = sp.Matrix([1, 0, 0, 0])
    assert (first.T * (A_E.T * P + P * A_E) * first)[0].expand() == 0
    # (57) drops the term ẽᵀPb ρ sign(ẽ₁), which has both signs in the half space ẽ₁ > 0 if p₄₄ > 0.
    term = (sp.Matrix([1, 0, 0, E4]).T * P * B_E)[0]
    assert vanishes(term - (P[0, 3] + P[3, 3] * E4))


def test_15_22_and_50_are_those_of_a_saturation_not_of_the_sign_term() -> None:
    """They contain a λ₀ that (13), (20) and (47) do not; it appears when sat(ẽ/δ) with δ = ρ/λ₀ replaces sign(ẽ)."""
    assert vanishes(dynamics(SATURATED, L3, L2, L1, L0) - V_DDOT)
    assert vanishes(A_E.charpoly(S).as_expr() - S * (S**3 + L3 * S**2 + L2 * S + L1))


def test_lambda_0_as_printed_leaves_a_pole_almost_at_the_origin() -> None:
    """With λ₀ = ω² the Luenberger stage has a pole at −1/(4ζω) = −5.6e-4 rad/s and settles in half an hour."""
    right = characteristic_polynomial(ObserverGains(500.0, 0.9))
    assert np.max(np.roots(right).real) == pytest.approx(-450.0, rel=1e-4)
    assert np.max(np.roots([*right[:4], 500.0**2]).real) == pytest.approx(-5.6e-4, rel=0.01)


def test_laws_as_printed_are_unstable_and_the_corrected_ones_are_not() -> None:
    """Poles of the closed loop with the gains of Section 5: F⁽⁶⁾ = v, −v by (51), and −v + 2K F⁽⁴⁾ by (52)."""
    w, zeta = 7.0, 0.9
    k = np.array(  # k₅ … k₀ as printed, the coefficients of (s² + 2ζωs + ω²)³
        [
            6 * w * zeta,
            12 * w**2 * zeta**2 + 3 * w**2,
            8 * w**3 * zeta**3 + 12 * w**3 * zeta,
            12 * w**4 * zeta**2 + 3 * w**4,
            6 * zeta * w**5,
            w**6,
        ]
    )
    quadratic = [1.0, 2.0 * zeta * w, w**2]
    np.testing.assert_allclose([1.0, *k], np.polymul(np.polymul(quadratic, quadratic), quadratic))
    second_term = np.array([0.0, 2.0 * PAPER.chain_stiffness, 0.0, 0.0, 0.0, 0.0])
    right, x_printed, y_printed = (np.roots([1.0, *rest]) for rest in (k, -k, -k - second_term))
    assert np.max(right.real) == pytest.approx(-6.3, abs=1e-3)
    assert min(np.max(x_printed.real), np.max(y_printed.real)) > 40.0  # 1/s: the pendulum falls within a second
