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

from dataclasses import dataclass
from math import factorial

import numpy as np
from scipy.linalg import expm

from quadpend_baselines.gains import ObserverGains
from quadpend_gym.core.arrays import Floats

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


@dataclass(frozen=True)
class ObserverBank:
    """m observers of integrator chains, computed together."""

    transition: Floats  # Φ, shape (4, 4)
    input_gains: Floats  # Γ of each observer, shape (m, 4)
    gains: Floats  # L of each observer, shape (m, 4)
    slopes: Floats  # ρT/δ of equation (3) of each observer, shape (m,)
    limits: Floats  # ρT of equation (3) of each observer, shape (m,)

    @classmethod
    def design(cls, observers: list[tuple[int, ObserverGains]], period: float) -> "ObserverBank":
        """Design observers from the driven state and the gains of each one, and the sampling period, s."""
        gains = np.array([current_gain(item, period) for _, item in observers])
        limits = np.array([np.inf if item.switching is None else item.switching * period for _, item in observers])
        slopes = [
            gain[-1] if item.layer is None else limit / max(item.layer, 1e-300)
            for gain, limit, (_, item) in zip(gains, limits, observers, strict=True)
        ]
        inputs = np.array([input_gain(driven_state, period) for driven_state, _ in observers])
        return cls(chain(period), inputs, gains, np.array(slopes), limits)

    def update(self, estimate: Floats, known_input: Floats, measured: Floats) -> Floats:
        """Return the estimates one period later, by equations (1)–(3).

        Args:
            estimate: x̂ one period ago, shape (n, m, 4).
            known_input: u over the period, shape (n, m).
            measured: y at the end of the period, shape (n, m).

        Returns:
            x̂ at the end of the period, shape (n, m, 4).
        """
        predicted = estimate @ self.transition.T + known_input[..., np.newaxis] * self.input_gains
        error = measured - predicted[..., 0]
        correction = error[..., np.newaxis] * self.gains
        correction[..., -1] = np.clip(error * self.slopes, -self.limits, self.limits)
        return np.asarray(predicted + correction)
