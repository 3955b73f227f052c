"""Extended state observers of integrator chains, discretised as current estimators.

Each observer of the paper estimates the states of a chain of four integrators from its output y = x₁ and a known input
u, which drives one of the states. In continuous time, with the output error e = y − x̂₁:

    Luenberger stage (46)   x̂ = (F, Ḟ, F̈, F⁽³⁾),        u = F⁽⁴⁾ drives the fourth,  gains λ₃, λ₂, λ₁, λ₀
    DESO (13), (20), (47)   x̂ = (y, ẏ, ϑ̂₁, ϑ̂₂),         u drives the second,         gains λ₃, λ₂, λ₁ and ρ sign(e)

and s⁴ + λ₃s³ + λ₂s² + λ₁s + λ₀ = (s² + 2ζω s + ω²)². Sampled with period T (Miklosovic, Radke & Gao, ACC 2006):

    (1)  predict   x̂⁻ = Φ x̂ + Γ u,              Φ = exp(A T), Γ = ∫ exp(A t) b dt
    (2)  correct   x̂  = x̂⁻ + L e,               e = y − x̂₁⁻,   error poles at exp(p T), p: roots of the polynomial
    (3)  DESO      last correction = ρ T sat(e / δ)

With δ = ρT / L₄ (the default), equation (3) is linear inside the boundary layer |e| < δ, with the gain L₄, and
saturates outside. δ = 0 gives the paper's sign term, and ρ = ∞ gives the linear ESO.
"""

from math import factorial
from typing import Any

import numpy as np
from scipy.linalg import expm

from quadpend_baselines.gains import ObserverGains
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined

ORDER = 4
LUENBERGER_INPUT, ESO_INPUT = 3, 1  # index of the state that the known input drives


def characteristic_polynomial(gains: ObserverGains) -> Floats:
    """Return the coefficients of (s² + 2ζω s + ω²)², highest power first, shape (5,): 1, λ₃, λ₂, λ₁, λ₀."""
    quadratic = [1.0, 2.0 * gains.damping * gains.bandwidth, gains.bandwidth**2]
    return np.asarray(np.polymul(quadratic, quadratic), np.float64)


def chain(period: float) -> Floats:
    """Return Φ of a chain of four integrators, shape (4, 4)."""
    return np.asarray(expm(np.eye(ORDER, k=1) * period))


def current_gain(gains: ObserverGains, period: float) -> Floats:
    """Return L of equation (2), shape (4,), by Ackermann's formula: L = Φ⁻¹ p(Φ) O⁻¹ e₄."""
    transition = chain(period)
    poles = np.exp(np.roots(characteristic_polynomial(gains)) * period)
    polynomial = np.real(np.poly(poles))
    placed = sum(c * np.linalg.matrix_power(transition, ORDER - i) for i, c in enumerate(polynomial))
    observability = np.array([np.linalg.matrix_power(transition, i)[0] for i in range(ORDER)])
    return np.linalg.solve(transition, placed @ np.linalg.solve(observability, np.eye(ORDER)[-1]))


def input_gain(driven_state: int, period: float) -> Floats:
    """Return Γ of equation (1) for an input that drives state number `driven_state`, shape (4,)."""
    lags = driven_state - np.arange(ORDER)
    return np.array([period ** (lag + 1) / factorial(lag + 1) if lag >= 0 else 0.0 for lag in lags])


def design_observers(observers: list[tuple[int, ObserverGains]], period: float) -> Floats:
    """Return what `update_observers` needs of m observers, shape (m, 10): Γ, L, and ρT/δ and ρT of equation (3).

    Args:
        observers: The driven state and the gains of each observer.
        period: Sampling period, s.
    """
    rows = []
    for driven_state, item in observers:
        gain, limit = current_gain(item, period), np.inf if item.switching is None else item.switching * period
        slope = gain[-1] if item.layer is None else limit / max(item.layer, 1e-300)
        rows.append([*input_gain(driven_state, period), *gain, slope, limit])
    return np.array(rows)


@inlined
def update_observers(
    estimate: Any, lane: int, input_before: Any, input_now: Any, measured: Any, bank: Any, period: float
) -> None:
    """Replace the estimates by those one period later, in place, by equations (1)–(3).

    Observer i has its x̂ in the four fields from 4 i, and takes the means of its known inputs u at both ends of the
    period (trapezoidal rule). `measured` has y at its end, and `bank` is that of `design_observers`.
    """
    t = period
    for i in range(bank.shape[0]):
        place, u = ORDER * i, 0.5 * (input_before[i] + input_now[i])
        d = estimate[place + 3, lane] + bank[i, 3] * u
        c = estimate[place + 2, lane] + t * estimate[place + 3, lane] + bank[i, 2] * u
        b = estimate[place + 1, lane] + t * (estimate[place + 2, lane] + t / 2.0 * estimate[place + 3, lane])
        a = estimate[place + 2, lane] + t / 3.0 * estimate[place + 3, lane]
        a = estimate[place, lane] + t * (estimate[place + 1, lane] + t / 2.0 * a) + bank[i, 0] * u
        error, limit = measured[i] - a, bank[i, 9]
        estimate[place, lane] = a + bank[i, 4] * error
        estimate[place + 1, lane] = b + bank[i, 1] * u + bank[i, 5] * error
        estimate[place + 2, lane] = c + bank[i, 6] * error
        estimate[place + 3, lane] = d + min(max(bank[i, 8] * error, -limit), limit)
