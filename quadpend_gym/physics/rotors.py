"""Four rotors and the on-board rate loop: from an action to the thrusts of the rotors.

An action commands a wrench (thrust and torques), a thrust and body rates, or the thrusts of the rotors. In every
substep of the integration

1. the rate loop converts commanded body rates ω_c into a torque, with the body's nominal inertia I:

       (1)  τ = I (k_ω (ω_c − ω)) − k_τ (τ_now − ω × I ω) + ω × I ω,

2. the allocation converts thrust and torques into thrusts within the limits. If they cannot all be reached, it gives up
   first the yaw torque, then the thrust, then the torques of roll and pitch,
3. the thrust of each rotor follows its command as a first-order lag, exactly integrated, with one time constant for
   rising and one for falling thrust.

`rate_loop_gains` places the two poles of (1) and of the lag at one point, such that after a small step of ω_c the rate
has covered 63 % of it after the stated time constant, whatever the lag. Without lag the loop is of first order.

A vehicle without rotors has the thrust and the three torques themselves in place of four thrusts.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Symmetric, Vec3, add, apply, axpy, cross, scale

WRENCH, BODY_RATES, ROTOR_THRUSTS = 0.0, 1.0, 2.0  # codes of the interfaces
# A critically damped system of second order reaches 1 − 1/e of a step after this time, in units of 1/|pole|.
_RISE = 2.1461932206205825


class Four(NamedTuple):
    """One number for each rotor; or thrust (N) and torques (N·m)."""

    a: float
    b: float
    c: float
    d: float


class Matrix4(NamedTuple):
    """A 4 × 4 matrix as its rows."""

    a: Four
    b: Four
    c: Four
    d: Four


class RotorSettings(NamedTuple):
    """Rotors of a vehicle inside compiled functions.

    Attributes:
        has_rotors: Above zero if the vehicle has rotors.
        mixing: Maps rotor thrusts (N) to thrust (N) and torques (N·m).
        unmixing: Its inverse.
        hover: Thrusts at hover, N.
        lowest: Lowest thrusts, N; without rotors the lowest thrust and torques.
        highest: Highest thrusts, N.
        spins: Sign of the yaw torque of each rotor.
        rise: Share of a thrust error that is left at the start, the middle and the end of a substep, rising thrust.
        fall: The same for falling thrust.
        momentum: J_p/√k, N·m·s/√N: a rotor with the thrust f has the angular momentum J_p √(f/k).
    """

    has_rotors: float
    mixing: Matrix4
    unmixing: Matrix4
    hover: Four
    lowest: Four
    highest: Four
    spins: Four
    rise: Vec3
    fall: Vec3
    momentum: float


class RateLoopSettings(NamedTuple):
    """The on-board rate loop inside compiled functions; `inertia` is the nominal one, kg·m²."""

    rate_gain: float  # k_ω, 1/s
    torque_gain: float  # k_τ, 1
    inertia: Symmetric


def rate_loop_gains(time_constant: float, lag: float, step: float) -> tuple[float, float]:
    """Return k_ω (1/s) and k_τ of equation (1), sampled with the substep.

    Args:
        time_constant: Time after which the rate has covered 63 % of a small step, s.
        lag: Time constant of the rotors, s; 0 for none.
        step: Length of a substep, s.
    """
    decay = np.exp(-step / lag) if lag > 0.0 else 0.0
    if decay < 1e-6:
        return float(-np.expm1(-step / time_constant) / step), 0.0
    pole = np.exp(-_RISE * step / time_constant)
    rate_gain = (1.0 - pole) ** 2 / ((1.0 - decay) * step)
    reach = step - lag * (1.0 - decay)
    return float(rate_gain), float((1.0 + decay - 2.0 * pole - reach * rate_gain) / (1.0 - decay))


@inlined
def _dot4(a: Four, b: Four) -> float:
    return a.a * b.a + a.b * b.b + a.c * b.c + a.d * b.d


@inlined
def multiply(matrix: Matrix4, v: Four) -> Four:
    """Return the product of a 4 × 4 matrix and a vector."""
    return Four(_dot4(matrix.a, v), _dot4(matrix.b, v), _dot4(matrix.c, v), _dot4(matrix.d, v))


@inlined
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@inlined
def clip4(v: Four, low: Four, high: Four) -> Four:
    """Return v with each component limited to [low, high]."""
    return Four(
        _clip(v.a, low.a, high.a), _clip(v.b, low.b, high.b), _clip(v.c, low.c, high.c), _clip(v.d, low.d, high.d)
    )


@inlined
def _column(matrix: Matrix4, factor: float, which: int) -> Four:
    return Four(factor * matrix.a[which], factor * matrix.b[which], factor * matrix.c[which], factor * matrix.d[which])


@inlined
def _plus(a: Four, b: Four) -> Four:
    return Four(a.a + b.a, a.b + b.b, a.c + b.c, a.d + b.d)


@inlined
def _largest(v: Four) -> float:
    return max(max(v.a, v.b), max(v.c, v.d))


@inlined
def _smallest(v: Four) -> float:
    return min(min(v.a, v.b), min(v.c, v.d))


@inlined
def _per_lift(limit: float, tilt: Four, lift: Four) -> Four:
    """Return the total thrust at which each rotor reaches a limit."""
    return Four(
        (limit - tilt.a) / lift.a, (limit - tilt.b) / lift.b, (limit - tilt.c) / lift.c, (limit - tilt.d) / lift.d
    )


@inlined
def _room(base: float, part: float, low: float, high: float) -> float:
    """Return the largest share of `part` that keeps base + share · part within [low, high]; 1 if `part` is zero."""
    room = high - base if part > 0.0 else base - low
    size = abs(part)
    return max(room, 0.0) / size if size > 0.0 else 1.0


@inlined
def allocate(wrench: Four, rotors: RotorSettings) -> Four:
    """Return rotor thrusts (N) within their limits for thrust (N) and torques (N·m), as the module describes."""
    low, high, unmixing = rotors.lowest.a, rotors.highest.a, rotors.unmixing
    tilt = _plus(_column(unmixing, wrench.b, 1), _column(unmixing, wrench.c, 2))
    spread = _largest(tilt) - _smallest(tilt)
    factor = (high - low) / spread if spread > high - low else 1.0
    tilt = Four(factor * tilt.a, factor * tilt.b, factor * tilt.c, factor * tilt.d)
    lift = _column(unmixing, 1.0, 0)
    least, greatest = _largest(_per_lift(low, tilt, lift)), _smallest(_per_lift(high, tilt, lift))
    base = _plus(tilt, _column(unmixing, min(max(wrench.a, least), greatest), 0))
    yaw = _column(unmixing, wrench.d, 3)
    room = Four(
        _room(base.a, yaw.a, low, high),
        _room(base.b, yaw.b, low, high),
        _room(base.c, yaw.c, low, high),
        _room(base.d, yaw.d, low, high),
    )
    share = min(_smallest(room), 1.0)
    total = Four(base.a + share * yaw.a, base.b + share * yaw.b, base.c + share * yaw.c, base.d + share * yaw.d)
    return clip4(total, rotors.lowest, rotors.highest)


@inlined
def rate_loop(rate: Vec3, wanted: Vec3, torque: Vec3, loop: RateLoopSettings) -> Vec3:
    """Return the torque that equation (1) commands; `torque` is the present one of the rotors, τ_now."""
    gyroscopic = cross(rate, apply(loop.inertia, rate))
    error = apply(loop.inertia, axpy(-1.0, rate, wanted))
    present = axpy(-1.0, gyroscopic, torque)
    return add(gyroscopic, axpy(loop.rate_gain, error, scale(-loop.torque_gain, present)))


@inlined
def from_hover(action: float, low: float, hover: float, high: float) -> float:
    """Return the thrust of a rotor that an action in [−1, 1] commands: low at −1, hover at 0, high at 1."""
    return hover + action * (high - hover if action > 0.0 else hover - low)


@inlined
def after(start: float, wanted: float, rise: float, fall: float) -> float:
    """Return the thrust after a time at which `rise` or `fall` of the difference from the command is left."""
    gap = start - wanted
    return wanted + gap * (rise if gap < 0.0 else fall)


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
