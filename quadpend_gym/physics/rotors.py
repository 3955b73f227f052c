"""Four rotors and the on-board rate loop: from an action to the thrusts of the rotors.

An action commands a wrench (thrust and torques), a thrust and body rates, or the thrusts of the rotors. In every
substep of the integration

1. the rate loop converts commanded body rates ω_c into a torque, with the body's nominal inertia I and the torque τ₀
   that holds the vehicle at hover:

       (1)  τ = I (k_ω (ω_c − ω)) − k_τ (τ_now − τ₀ − ω × I ω) + ω × I ω + τ₀,

2. the allocation converts thrust and torques into thrusts within the limits. If they cannot all be reached, it gives up
   first the yaw torque, then the thrust, then the torques of roll and pitch. It reduces the yaw torque to zero at most,
3. the thrust of each rotor follows its command as a first-order lag, exactly integrated, with one time constant for
   rising and one for falling thrust.

`rate_loop_gains` chooses the gains such that after a small step of ω_c the rate has covered 63 % of it after the stated
time constant. It places the two poles of (1) and of the lag at one point if that is faster than k_τ = 0 allows; a
slower loop has k_τ = 0. A step is small if no thrust reaches its limit.

A vehicle without rotors has the thrust and the three torques themselves in place of four thrusts.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.elementary import select
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Four, Matrix4, Symmetric, Vec3, add, apply, axpy, cross, multiply, scale, times

WRENCH, BODY_RATES, ROTOR_THRUSTS = 0.0, 1.0, 2.0  # codes of the interfaces
# A critically damped system of second order reaches 1 − 1/e of a step after this time, in units of 1/|pole|.
_RISE = 2.1461932206205825


class Ratio(NamedTuple):
    """A ratio of two numbers; comparisons of ratios need no division."""

    numerator: float
    denominator: float


class RotorSettings(NamedTuple):
    """Rotors of a vehicle inside compiled functions."""

    has_rotors: float  # above zero if the vehicle has rotors
    mixing: Matrix4  # maps rotor thrusts (N) to thrust (N) and torques (N·m)
    efficiency: Four  # thrusts that act, divided by those that the same command makes in the nominal loop
    unmixing: Matrix4  # its inverse
    hover: Four  # thrusts at hover, N
    lowest: Four  # lowest thrusts, N; without rotors the lowest thrust and torques
    highest: Four  # highest thrusts, N
    spins: Four  # sign of the yaw torque of each rotor
    rise: Vec3  # share of a thrust error that is left at the start, the middle and the end of a substep, rising thrust
    fall: Vec3  # the same for falling thrust
    # J_p/√c, N·m·s/√N: a rotor with the thrust f has the angular momentum J_p √(f/c); c is the thrust per squared
    # speed, N·s²/rad²
    momentum: float


class RateLoopSettings(NamedTuple):
    """The on-board rate loop inside compiled functions; `inertia` is the nominal one, kg·m²."""

    rate_gain: float  # k_ω, 1/s
    torque_gain: float  # k_τ, 1
    inertia: Symmetric


def rate_loop_gains(time_constant: float, lag: float, step: float) -> tuple[float, float]:
    """Return k_ω (1/s) and k_τ of equation (1); `lag` is that of the rotors, and `step` that of the integration, s."""
    decay, slow = np.exp(-step / lag) if lag > 0.0 else 0.0, 2.0 * _RISE * lag
    speed_up = 1.0 + (0.5 * _RISE - 1.0) * (slow / time_constant) ** 2
    alone = -speed_up * np.expm1(-step / time_constant) / step
    if decay < 1e-6:
        return float(alone), 0.0
    pole = np.exp(-_RISE * step / time_constant)
    rate_gain = (1.0 - pole) ** 2 / ((1.0 - decay) * step)
    reach = step - lag * (1.0 - decay)
    torque_gain = (1.0 + decay - 2.0 * pole - reach * rate_gain) / (1.0 - decay)
    is_slow = time_constant > slow
    return float(np.where(is_slow, alone, rate_gain)), float(np.where(is_slow, 0.0, torque_gain))


@inlined
def wrench_of(thrusts: Four, rotors: RotorSettings) -> Four:
    """Return thrust (N) and torques (N·m) of rotor thrusts (N)."""
    share = rotors.efficiency
    acting = Four(share.a * thrusts.a, share.b * thrusts.b, share.c * thrusts.c, share.d * thrusts.d)
    return multiply(rotors.mixing, acting)


@inlined
def clip(value: float, low: float, high: float) -> float:
    """Return a number limited to [low, high]."""
    return min(max(value, low), high)


@inlined
def clip4(v: Four, low: Four, high: Four) -> Four:
    """Return v with each component limited to [low, high]."""
    return Four(clip(v.a, low.a, high.a), clip(v.b, low.b, high.b), clip(v.c, low.c, high.c), clip(v.d, low.d, high.d))


@inlined
def _column(matrix: Matrix4, factor: float, which: int) -> Four:
    return Four(factor * matrix.a[which], factor * matrix.b[which], factor * matrix.c[which], factor * matrix.d[which])


@inlined
def _plus(a: Four, b: Four) -> Four:
    return Four(a.a + b.a, a.b + b.b, a.c + b.c, a.d + b.d)


@inlined
def _limit(share: Ratio, needed: float, room: float) -> Ratio:
    """Return the smaller one of `share` and room/needed; `share` if nothing is needed. `room` is not negative."""
    smaller = room * share.denominator < share.numerator * needed
    return Ratio(select(smaller, room, share.numerator), select(smaller, needed, share.denominator))


@inlined
def _limit_difference(share: Ratio, a: float, per_a: float, b: float, per_b: float, low: float, high: float) -> Ratio:
    """Limit the share of a tilt such that some total thrust keeps the rotors a and b within [low, high].

    a, b: Part of the tilt in each rotor's thrust, divided by the rotor's part of the total thrust.
    per_a, per_b: The inverse of each rotor's part of the total thrust.
    """
    share = _limit(share, a - b, high * per_a - low * per_b)
    return _limit(share, b - a, high * per_b - low * per_a)


@inlined
def _reachable_tilt(tilt: Four, per_lift: Four, low: float, high: float) -> float:
    """Return the largest share of `tilt` in [0, 1] that is within the limits at some total thrust.

    Each rotor allows an interval of total thrusts. Intervals on a line have a common point if every two of them have
    one, so it suffices to check all pairs of rotors.
    """
    s, p = Four(tilt.a * per_lift.a, tilt.b * per_lift.b, tilt.c * per_lift.c, tilt.d * per_lift.d), per_lift
    share = Ratio(1.0, 1.0)
    share = _limit_difference(share, s.a, p.a, s.b, p.b, low, high)
    share = _limit_difference(share, s.a, p.a, s.c, p.c, low, high)
    share = _limit_difference(share, s.a, p.a, s.d, p.d, low, high)
    share = _limit_difference(share, s.b, p.b, s.c, p.c, low, high)
    share = _limit_difference(share, s.b, p.b, s.d, p.d, low, high)
    share = _limit_difference(share, s.c, p.c, s.d, p.d, low, high)
    return share.numerator / share.denominator


@inlined
def _limit_part(share: Ratio, base: float, part: float, low: float, high: float) -> Ratio:
    """Limit the share of `part` such that base + share · part is within [low, high]."""
    return _limit(share, abs(part), max(select(part > 0.0, high - base, base - low), 0.0))


@inlined
def _reachable_part(base: Four, part: Four, low: float, high: float) -> float:
    """Return the largest share of `part` in [0, 1] that keeps base + share · part within the limits."""
    share = Ratio(1.0, 1.0)
    share = _limit_part(share, base.a, part.a, low, high)
    share = _limit_part(share, base.b, part.b, low, high)
    share = _limit_part(share, base.c, part.c, low, high)
    share = _limit_part(share, base.d, part.d, low, high)
    return share.numerator / share.denominator


@inlined
def allocate(wrench: Four, rotors: RotorSettings) -> Four:
    """Return rotor thrusts (N) within their limits for thrust (N) and torques (N·m), as the module describes."""
    low, high, unmixing = rotors.lowest.a, rotors.highest.a, rotors.unmixing
    lift = _column(unmixing, 1.0, 0)
    p = Four(1.0 / lift.a, 1.0 / lift.b, 1.0 / lift.c, 1.0 / lift.d)
    tilt = _plus(_column(unmixing, wrench.b, 1), _column(unmixing, wrench.c, 2))
    tilt = times(_reachable_tilt(tilt, p, low, high), tilt)
    # The total thrusts at which the first rotor reaches a limit.
    least = max(max((low - tilt.a) * p.a, (low - tilt.b) * p.b), max((low - tilt.c) * p.c, (low - tilt.d) * p.d))
    greatest = min(min((high - tilt.a) * p.a, (high - tilt.b) * p.b), min((high - tilt.c) * p.c, (high - tilt.d) * p.d))
    base = _plus(tilt, times(min(max(wrench.a, least), greatest), lift))
    yaw = _column(unmixing, wrench.d, 3)
    near, exact = _plus(base, times(_reachable_part(base, yaw, low, high), yaw)), multiply(unmixing, wrench)
    excess = max(
        low - min(min(exact.a, exact.b), min(exact.c, exact.d)),
        max(max(exact.a, exact.b), max(exact.c, exact.d)) - high,
    )
    return Four(
        select(excess <= 0.0, exact.a, clip(near.a, low, high)),
        select(excess <= 0.0, exact.b, clip(near.b, low, high)),
        select(excess <= 0.0, exact.c, clip(near.c, low, high)),
        select(excess <= 0.0, exact.d, clip(near.d, low, high)),
    )


@inlined
def rate_loop(rate: Vec3, wanted: Vec3, torque: Vec3, loop: RateLoopSettings) -> Vec3:
    """Return the torque τ − τ₀ that equation (1) commands; `torque` is the present one of the rotors, τ_now − τ₀."""
    gyroscopic = cross(rate, apply(loop.inertia, rate))
    error = apply(loop.inertia, axpy(-1.0, rate, wanted))
    present = axpy(-1.0, gyroscopic, torque)
    return add(gyroscopic, axpy(loop.rate_gain, error, scale(-loop.torque_gain, present)))


@inlined
def _from_hover(action: float, low: float, hover: float, high: float) -> float:
    return hover + action * select(action > 0.0, high - hover, hover - low)


@inlined
def thrusts_from_hover(action: Four, rotors: RotorSettings) -> Four:
    """Return the rotor thrusts (N) that actions in [−1, 1] command: lowest at −1, hover at 0, highest at 1."""
    low, hover, high = rotors.lowest, rotors.hover, rotors.highest
    return Four(
        _from_hover(action.a, low.a, hover.a, high.a),
        _from_hover(action.b, low.b, hover.b, high.b),
        _from_hover(action.c, low.c, hover.c, high.c),
        _from_hover(action.d, low.d, hover.d, high.d),
    )


@inlined
def _after(start: float, wanted: float, rise: float, fall: float) -> float:
    gap = start - wanted
    return wanted + gap * select(gap < 0.0, rise, fall)


@inlined
def thrusts_after(start: Four, wanted: Four, rise: float, fall: float) -> Four:
    """Return the thrusts after a time at which `rise` or `fall` of the difference from the command is left."""
    return Four(
        _after(start.a, wanted.a, rise, fall),
        _after(start.b, wanted.b, rise, fall),
        _after(start.c, wanted.c, rise, fall),
        _after(start.d, wanted.d, rise, fall),
    )


@inlined
def propeller_momentum(thrusts: Four, rotors: RotorSettings) -> float:
    """Return the angular momentum of the propellers along e₃ in N·m·s.

    A propeller turns against the yaw torque that it brings.
    """
    spins = rotors.spins
    total = (
        spins.a * np.sqrt(max(thrusts.a, 0.0))
        + spins.b * np.sqrt(max(thrusts.b, 0.0))
        + spins.c * np.sqrt(max(thrusts.c, 0.0))
        + spins.d * np.sqrt(max(thrusts.d, 0.0))
    )
    return float(-rotors.momentum * total)
