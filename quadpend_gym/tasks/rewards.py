"""The reward: a weighted mean of four terms in [0, 1]. It is 1 only for exact tracking with zero action.

With the tracking error e (m), the yaw error ψ_e (rad), the action a, and h = cos of the angle between the pendulum and
the side on which it is to be: h = r_z for an upright one, h = −r_z for a hanging one:

    (1)  tracking = (1 − s) / (1 + (|e| / 0.3 m)²) + s / (1 + |e| / 0.02 m)     a wide and a narrow peak
    (2)  upright  = max(h, 0)²
    (3)  yaw      = 1 / (1 + (ψ_e / 0.2 rad)²)
    (4)  effort   = 1 / (1 + |a|²)
    (5)  reward   = (1 − p + p (1 + h)²/4 / (1 + (|ṙ| / 5 s⁻¹)²)) · weighted mean of (1) to (4)
    (6)  with q > 0 it is multiplied by 1 − q + q / (1 + (|a − a₋| / (10 s⁻¹ · T))²)

The weight s of the narrow peak is `RewardWeights.tip`, by default ½. p is `RewardWeights.pendulum_first`, by default 0:
with 1, nothing is rewarded while the pendulum is on the opposite side, and little while it spins. q is
`RewardWeights.action_rate`, by default 0; a₋ is the action of the step before, at first hover, and T the control
period. No term is negative, so an early termination never increases the return.
"""

from typing import Any, NamedTuple

from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Vec3, dot, norm

_FAR, _NEAR, _YAW = 0.3, 0.02, 0.2  # m, m, rad; half-widths of the peaks in (1) and (3)
_SWING, _RATE = 5.0, 10.0  # 1/s, half-widths of the peaks in (5) and (6)


class Reward(NamedTuple):
    """The terms (1)–(4), each in [0, 1]."""

    tracking: float
    upright: float
    yaw: float
    effort: float


@inlined
def reward_terms(error: Vec3, cosine: float, yaw_error: float, action: Any, lane: int, tip: float) -> Reward:
    """Return the terms (1)–(4) for e (m), h, ψ_e (rad), the action in column `lane` of a (4, n) buffer, and s."""
    far = 1.0 / (1.0 + dot(error, error) / _FAR**2)
    near = 1.0 / (1.0 + norm(error) / _NEAR)
    above = max(cosine, 0.0)
    effort = action[0, lane] ** 2 + action[1, lane] ** 2 + action[2, lane] ** 2 + action[3, lane] ** 2
    return Reward(
        (1.0 - tip) * far + tip * near,
        above * above,
        1.0 / (1.0 + (yaw_error / _YAW) ** 2),
        1.0 / (1.0 + effort),
    )


@inlined
def reward(terms: Reward, cosine: float, rate: Vec3, weights: Any) -> float:
    """Return the reward, equation (5), from the terms, h, ṙ (1/s) and the `KernelWeights`."""
    reached = 0.25 * (1.0 + cosine) * (1.0 + cosine) / (1.0 + dot(rate, rate) / _SWING**2)
    mean = (
        weights.tracking * terms.tracking
        + weights.upright * terms.upright
        + weights.yaw * terms.yaw
        + weights.effort * terms.effort
    )
    return float((1.0 - weights.pendulum_first * (1.0 - reached)) * mean)


def steady_share(change: Any, period: float, share: float) -> Any:
    """Return the factor (6) for the four components of a − a₋, numbers or arrays, T (s) and q."""
    squared = change[0] ** 2 + change[1] ** 2 + change[2] ** 2 + change[3] ** 2
    return 1.0 - share + share / (1.0 + squared / (_RATE * period) ** 2)
