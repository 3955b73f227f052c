"""Faults of the paper's design that are not misprints: entry of the wind, offsets, torques, and noise."""

import numpy as np
import pytest

from quadpend_baselines.estimation.observers import characteristic_polynomial
from quadpend_baselines.gains import ADRC_GAINS
from quadpend_gym.core.arrays import Floats
from quadpend_gym.vehicles import PAPER
from tests.helpers.symbolic import (
    FORCE_ON_BOB,
    FORCE_ON_QUADROTOR,
    I_theta,
    K,
    M,
    g,
    length,
    linearise,
    m_c,
    r_x,
    tau_theta,
    theta,
    vanishes,
    x,
)

GAINS = ADRC_GAINS["paper"]
PER_NEWTON = PAPER.gravity / (PAPER.quadrotor_mass * PAPER.rod_length)  # g/(M l): F⁽⁴⁾ per newton on the quadrotor
_SLOW = [GAINS.horizontal_bandwidth**2, 2.0 * GAINS.damping * GAINS.horizontal_bandwidth, 1.0]
FEEDBACK = np.polynomial.polynomial.polypow(_SLOW, 3)[:-1]  # k₀ … k₅


def test_wind_enters_at_the_fourth_derivative_not_at_the_sixth() -> None:
    """On the quadrotor F⁽⁴⁾ = F₅ − g d/(M l), on the bob F̈ = g r_x + b/m_c; in both cases F₅ + ϑ/K is F⁽⁴⁾."""
    chain, (d, *others), (b, *bob_others) = linearise(), FORCE_ON_QUADROTOR, FORCE_ON_BOB
    fifth = g * K * (r_x - theta)  # what the paper calls F⁽⁴⁾, (36)
    vartheta = chain.derivative(fifth, 2) + g * K / I_theta * tau_theta - K * fifth
    second, fourth = (chain.derivative(x + length * r_x, order) for order in (2, 4))
    no_others = dict.fromkeys([*others, *bob_others], 0)
    assert vanishes((fourth - (fifth + vartheta / K)).subs(no_others))
    assert vanishes((fourth - (fifth - g * d / (M * length))).subs({**no_others, b: 0}))
    assert vanishes((second - (g * r_x + b / m_c)).subs({**no_others, d: 0}))


def stationary_offset(observer: Floats) -> float:
    """Return the steady error of F under 1 N, m: k₀ e = (k₄ + (k₀ + k₁λ₃ + k₂λ₂ + k₃λ₁)/λ₀) g/(M l)."""
    _, l3, l2, l1, l0 = observer
    from_observer = FEEDBACK[:4] @ [1.0, l3, l2, l1] / l0
    return float((FEEDBACK[4] + from_observer) / FEEDBACK[0] * PER_NEWTON)


def closed_loop(observer: Floats, mismatch: float) -> tuple[Floats, Floats]:
    """Return A, b of ẋ = A x + b d for one horizontal channel.

    x consists of F … F⁽³⁾, F₅, F₆, the Luenberger stage, the linear DESO, and the linear DESO of the force.
    """
    size, luenberger, deso, force = 18, 6, 10, 14
    A, b = np.zeros((size, size)), np.zeros(size)
    row = np.eye(size)
    fourth_feedback = row[4] + mismatch * row[force + 2]
    fifth_feedback = row[deso + 1] + mismatch * row[force + 3]
    v = -FEEDBACK[:4] @ row[luenberger : luenberger + 4] - FEEDBACK[4] * fourth_feedback - FEEDBACK[5] * fifth_feedback
    v = v - row[deso + 2]
    A[0:3] = row[1:4]
    A[3], b[3] = row[4], -PER_NEWTON
    A[4] = row[5]
    A[5], b[5] = v, -PAPER.chain_stiffness * PER_NEWTON
    gains = observer[1:, np.newaxis]
    A[luenberger : luenberger + 4] = gains * (row[0] - row[luenberger])
    A[luenberger : luenberger + 3] += row[luenberger + 1 : luenberger + 4]
    A[luenberger + 3] += fourth_feedback
    right = characteristic_polynomial(GAINS.horizontal)[1:, np.newaxis]
    for first, output, known_input in ((deso, row[4], v), (force, row[2], row[4])):
        A[first : first + 4] = right * (output - row[first])
        A[first : first + 3] += row[first + 1 : first + 4]
        A[first + 1] += known_input
    return A, b


def test_paper_law_has_an_offset_and_the_matched_law_has_none() -> None:
    """0.346 m per newton by (51) alone, 0.369 m with the Luenberger stage, and none with F₅ + δ̂ for F⁽⁴⁾."""
    observer = characteristic_polynomial(GAINS.luenberger)
    assert FEEDBACK[4] / FEEDBACK[0] * PER_NEWTON == pytest.approx(0.346, abs=5e-4)
    assert stationary_offset(observer) == pytest.approx(0.369, abs=5e-4)
    for mismatch, expected in ((0.0, -stationary_offset(observer)), (1.0, 0.0)):
        A, b = closed_loop(observer, mismatch)
        assert np.max(np.linalg.eigvals(A).real) < -5.0
        assert np.linalg.solve(A, -b)[0] == pytest.approx(expected, abs=1e-9)


def test_printed_lambda_0_turns_the_offset_into_a_drift() -> None:
    """With λ₀ = ω², a steady wind moves the quadrotor by 3.2 m per second and newton, for half an hour."""
    observer = characteristic_polynomial(GAINS.luenberger).copy()
    observer[-1] = GAINS.luenberger.bandwidth**2
    A, b = closed_loop(observer, 0.0)
    assert np.max(np.linalg.eigvals(A).real) == pytest.approx(-5.6e-4, rel=0.01)
    rest = np.linalg.solve(A, -b)
    values, vectors = np.linalg.eig(A)
    share = np.linalg.solve(vectors, rest.astype(complex))

    def error(time: float) -> float:
        return float((rest - np.real(vectors @ (np.exp(values * time) * share)))[0])

    assert (error(12.0) - error(10.0)) / 2.0 == pytest.approx(-3.2, rel=0.02)


def test_matched_law_amplifies_the_noise_of_the_estimate() -> None:
    """ϑ̂ enters v with 1 in both laws, and K δ̂, which has the same noise of r_xy, with k₄/K = 13.6."""
    assert FEEDBACK[4] / PAPER.chain_stiffness == pytest.approx(13.6, abs=0.05)


def test_one_metre_of_error_demands_26_newton_metres() -> None:
    """The torque is k₀ I/(gK) at ω_nc = 7 rad/s, with the inertia of Table 1."""
    torque = FEEDBACK[0] * PAPER.inertia_pitch / (PAPER.gravity * PAPER.chain_stiffness)
    assert torque == pytest.approx(26.25, abs=0.05)
