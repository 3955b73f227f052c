"""Theorems 1 and 2 of the paper: which of their claims hold, and which bounds can be proven instead.

The errors of the paper's observers and loops satisfy e⁽ⁿ⁾ + a₍ₙ₋₁₎ e⁽ⁿ⁻¹⁾ + … + a₀ e = w. For the DESO inside the layer
δ = ρ/λ₀, w = ϑ̈; for (61)–(63), w = ϑ − ϑ̂. In the phase variables ė = A e + b w with |w| ≤ D. The ultimate bounds are:

    (1)  |eᵢ(t)| ≤ gᵢ D,  gᵢ = ∫₀^∞ |(e^(At) b)ᵢ| dt                          sharp: a bounded w attains it
    (2)  ‖e‖ ≤ D / |Re σmax(A)|                                              (59), (72) as printed

Some tests measure time in units of 1/ω, and say so. All eᵢ then have the unit of e, and A depends on ζ only.
"""

from functools import reduce

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from quadpend_gym.core.arrays import Floats

ZETA = 0.9  # ζ and ζ_c of Section 5
# Order and bandwidth (rad/s) of the error dynamics with the gains of Section 5.
SECTION_5 = {"DESO, (59)": (4, 500.0), "z and ψ, (72)": (2, 10.0), "F, (72)": (6, 7.0)}


def polynomial(order: int, bandwidth: float = 1.0, damping: float = ZETA) -> Floats:
    """Return the coefficients of (s² + 2ζωs + ω²)^(order/2), highest power first."""
    quadratic = np.array([1.0, 2.0 * damping * bandwidth, bandwidth**2])
    return np.asarray(reduce(np.polymul, [quadratic] * (order // 2)))


def companion_matrix(coefficients: Floats) -> Floats:
    """Return A of ė = A e + b w in phase variables for a characteristic polynomial, highest power first."""
    order = coefficients.size - 1
    matrix = np.eye(order, k=1)
    matrix[-1] = -coefficients[:0:-1]
    return matrix


def impulse_response(matrix: Floats, step: float, seconds: float) -> Floats:
    """Return e^(At) b on a grid of times, shape (steps, n)."""
    transition, state = expm(matrix * step), np.eye(len(matrix))[-1]
    out = np.empty((round(seconds / step), len(matrix)))
    for row in out:
        row[:] = state
        state = transition @ state
    return out


def peak_gains(order: int, bandwidth: float) -> Floats:
    """Return gᵢ of (1), shape (n,)."""
    step = 5e-3 / bandwidth
    response = impulse_response(companion_matrix(polynomial(order, bandwidth)), step, 40.0 / (ZETA * bandwidth))
    return np.asarray(np.trapezoid(np.abs(response), dx=step, axis=0))


def lyapunov(matrix: Floats, right: Floats | None = None) -> Floats:
    """Return P of AᵀP + PA = −Q; Q is `right`, by default I."""
    return np.asarray(solve_continuous_lyapunov(matrix.T, -np.eye(len(matrix)) if right is None else -right))


def printed_radius(matrix: Floats) -> float:
    """Return the radius (2) for D = 1."""
    return float(1.0 / np.abs(np.max(np.linalg.eigvals(matrix).real)))


def test_54_has_a_solution_with_lambda_0() -> None:
    """With the last row −λ₀, −λ₁, −λ₂, −λ₃ of A_e, which is right inside the layer, a solution P > 0 exists."""
    with_lambda = companion_matrix(polynomial(4))
    P = lyapunov(with_lambda)
    np.testing.assert_allclose(with_lambda.T @ P + P @ with_lambda, -np.eye(4), atol=1e-12)
    assert np.min(np.linalg.eigvalsh(P)) > 0.0


@pytest.mark.parametrize("order", [2, 4, 6])
def test_57_and_70_hold_for_no_lyapunov_function(order: int) -> None:
    """½ eᵀ(AᵀP + PA)e ≤ −‖e‖²‖P‖|Re σmax| is false for all Q tested, since always λmin(Q) ≤ 2 |Re σmax| λmax(P)."""
    matrix = companion_matrix(polynomial(order))
    rng = np.random.default_rng(0)
    for _ in range(100):
        root = rng.normal(size=(order, order))
        Q = root @ root.T
        values, vectors = np.linalg.eigh(Q)
        P = lyapunov(matrix, Q)
        e = vectors[:, 0]
        claimed = -np.linalg.norm(P, 2) / printed_radius(matrix)
        assert 0.5 * e @ (matrix.T @ P + P @ matrix) @ e == pytest.approx(-0.5 * values[0])
        assert -0.5 * values[0] > claimed


@pytest.mark.parametrize("system", SECTION_5)
def test_59_and_72_are_ultimate_bounds_at_section_5s_gains_but_not_invariant_sets(system: str) -> None:
    """'No path entering S(0, ρ) will ever leave it': the undisturbed error that starts at (ρ/2, 0, …) leaves it.

    The largest eigenvalue of A_e as printed, without λ₀, is 0, so the radius (59) is infinite.
    """
    order, bandwidth = SECTION_5[system]
    matrix = companion_matrix(polynomial(order, bandwidth))
    radius = printed_radius(matrix)
    state = np.zeros(order)
    state[0] = 0.5 * radius
    transition = expm(matrix * 0.02 / bandwidth)
    path = []
    for _ in range(3000):
        state = transition @ state
        path.append(np.linalg.norm(state))
    assert max(path) > 1.5 * radius
    assert np.linalg.norm(peak_gains(order, bandwidth)) < radius
    matrix[-1, 0] = 0.0
    assert np.max(np.linalg.eigvals(matrix).real) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("order", "bandwidth", "damping", "factor"), [(4, 0.5, ZETA, 7.2), (6, 7.0, 0.2, 4.4)])
def test_59_and_72_fail_for_slow_or_lightly_damped_errors(
    order: int, bandwidth: float, damping: float, factor: float
) -> None:
    """A bounded disturbance drives the error out of the printed ball by this factor.

    For slow errors the reason is the units: ‖e‖ adds m, m/s, m/s², …, so (2) depends on the unit of time.
    """
    matrix = companion_matrix(polynomial(order, bandwidth, damping))
    error = np.max(worst_response(matrix, 0.01 / bandwidth, 40.0 / (damping * bandwidth), 1.0))
    assert error / printed_radius(matrix) == pytest.approx(factor, rel=0.03)


def worst_response(matrix: Floats, step: float, seconds: float, size: float) -> Floats:
    """Simulate the worst disturbance |w| ≤ size for each eᵢ and return the final values of |eᵢ|, shape (n,)."""
    order = len(matrix)
    response = impulse_response(matrix, step, seconds)
    augmented = np.zeros((order + 1, order + 1))
    augmented[:order, :order], augmented[order - 1, order] = matrix, 1.0
    transition = expm(augmented * step)
    errors = np.zeros((order, order))  # column i: the error under the worst disturbance for eᵢ
    for now in response[::-1]:
        errors = transition[:order, :order] @ errors + np.outer(transition[:order, order], size * np.sign(now))
    return np.abs(np.diag(errors))


# The observer with its switching term, time in units of 1/ω, ρ = 1, errors ε = (ẽ₁, ẽ₂, ϑ − ϑ̂₁, ϑ̇ − ϑ̂₂)


def simulate(slope: float, start: Floats, seconds: float, disturbance: float = 0.0, frequency: float = 1.0) -> Floats:
    """Simulate the errors of the DESO with the term ρ sat(slope·ẽ) under ϑ̈ = D sin(ωt).

    An infinite slope is the sign function. The result has one row for each step of 0.002.
    """
    step = 2e-3
    _, l3, l2, l1, _ = polynomial(4)
    augmented = np.eye(5, k=1)
    augmented[:4, 0] = -l3, -l2, -l1, 0.0
    transition = expm(augmented * step)
    state = np.array(start, np.float64)
    inputs = disturbance * np.sin(frequency * step * (np.arange(round(seconds / step)) + 0.5))
    out = np.empty((inputs.size, 4))
    for i, w in enumerate(inputs):
        switch = np.sign(state[0]) if np.isinf(slope) else np.clip(slope * state[0], -1.0, 1.0)
        state = transition[:4, :4] @ state + transition[:4, 4] * (w - switch)
        out[i] = state
    return out


def test_sign_term_has_the_limit_cycle_that_its_describing_function_predicts() -> None:
    """Without a disturbance ẽ oscillates at ω with 4ρ/(π ω⁴(4ζ²+1)) and ϑ̂ with 1.67 ρ/ω²; ϑ̂ does not converge to ϑ."""
    errors = simulate(np.inf, np.array([1.0, 0.0, 0.0, 0.0]), seconds=120.0)[-20_000:]
    margin = 4.0 * ZETA**2 + 1.0
    amplitude, ripple = 4.0 / np.pi / margin, 4.0 / np.pi * np.hypot(1.0, 4.0 * ZETA / margin)
    assert ripple == pytest.approx(1.67, abs=0.001)
    assert np.max(np.abs(errors[:, 0])) == pytest.approx(amplitude, rel=0.03)  # the prediction is good to ±10 %
    assert np.max(np.abs(errors[:, 2])) == pytest.approx(ripple, rel=0.04)


def test_saturated_term_stays_in_its_layer() -> None:
    """If |ϑ̈| ≤ D and ρ ≥ g₁λ₀ D = 1.003 D, the error that starts at zero stays in the layer.

    In the layer the observer is linear. The sharp bounds are |ẽ| ≤ 1.003 D/ω⁴ and |ϑ − ϑ̂| ≤ 5.25 D/ω². The sign term
    adds its ripple to them.
    """
    assert peak_gains(4, 1.0)[0] == pytest.approx(1.003, abs=1e-3)
    to_estimate = polynomial(4)[2::-1]  # ϑ − ϑ̂ = ẽ̈ + λ₃ẽ̇ + λ₂ẽ
    response = impulse_response(companion_matrix(polynomial(4)), 5e-3, 40.0)[:, :3] @ to_estimate
    gain = np.trapezoid(np.abs(response), dx=5e-3)
    assert gain == pytest.approx(5.25, rel=0.01)
    for frequency in (0.6, 1.0):
        errors = simulate(1.0, np.zeros(4), seconds=100.0, disturbance=1.0 / 1.003, frequency=frequency)
        assert np.max(np.abs(errors[:, 0])) <= 1.0
        assert np.max(np.abs(errors[:, 2])) <= gain
