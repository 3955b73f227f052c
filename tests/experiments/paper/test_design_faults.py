"""Faults of the paper's design that are not misprints: entry of the wind, offsets, torques, and the sign term."""

import numpy as np
import pytest
from scipy.linalg import expm

from quadpend_baselines.estimation.observers import characteristic_polynomial
from quadpend_baselines.gains import tuning
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

GAINS = tuning("adrc-paper").gains
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


def test_paper_law_has_an_offset_in_steady_wind() -> None:
    """k₀ e = (k₄ + (k₀ + k₁λ₃ + k₂λ₂ + k₃λ₁)/λ₀) g d/(M l): 0.346 m per newton from k₄ alone, 0.369 m with (46)."""
    _, l3, l2, l1, l0 = characteristic_polynomial(GAINS.luenberger)
    from_observer = FEEDBACK[:4] @ [1.0, l3, l2, l1] / l0
    assert FEEDBACK[4] / FEEDBACK[0] * PER_NEWTON == pytest.approx(0.346, abs=5e-4)
    assert (FEEDBACK[4] + from_observer) / FEEDBACK[0] * PER_NEWTON == pytest.approx(0.369, abs=5e-4)


def test_matched_law_amplifies_the_noise_of_the_estimate() -> None:
    """ϑ̂ enters v with 1 in both laws, and K δ̂, which has the same noise of r_xy, with k₄/K = 13.6."""
    assert FEEDBACK[4] / PAPER.chain_stiffness == pytest.approx(13.6, abs=0.05)


def test_one_metre_of_error_demands_26_newton_metres() -> None:
    """The torque is k₀ I/(gK) at ω_nc = 7 rad/s, with the inertia of Table 1."""
    torque = FEEDBACK[0] * PAPER.inertia_pitch / (PAPER.gravity * PAPER.chain_stiffness)
    assert torque == pytest.approx(26.25, abs=0.05)


def test_sign_term_has_the_limit_cycle_that_its_describing_function_predicts() -> None:
    """Without a disturbance ẽ oscillates at ω with 4ρ/(π ω⁴(4ζ²+1)) and ϑ̂ with 1.67 ρ/ω²; ϑ̂ does not converge to ϑ.

    Time is measured in units of 1/ω, and ρ = 1. The errors are (ẽ₁, ẽ₂, ϑ − ϑ̂₁, ϑ̇ − ϑ̂₂).
    """
    zeta = GAINS.damping
    augmented = np.eye(5, k=1)
    augmented[:4, 0] = -4.0 * zeta, -2.0 - 4.0 * zeta**2, -4.0 * zeta, 0.0
    transition, state, errors = expm(2e-3 * augmented), np.array([1.0, 0.0, 0.0, 0.0]), np.empty((60_000, 4))
    for i in range(len(errors)):
        errors[i] = state = transition[:4, :4] @ state - transition[:4, 4] * np.sign(state[0])
    margin = 4.0 * zeta**2 + 1.0
    amplitude, ripple = 4.0 / np.pi / margin, 4.0 / np.pi * np.hypot(1.0, 4.0 * zeta / margin)
    assert ripple == pytest.approx(1.67, abs=0.001)
    largest = np.abs(errors[-20_000:]).max(axis=0)
    assert largest[0] == pytest.approx(amplitude, rel=0.03)  # the prediction is good to ±10 %
    assert largest[2] == pytest.approx(ripple, rel=0.04)
