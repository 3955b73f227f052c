"""Layout and scales of the observation: 36 numbers, float32.

`OBSERVATION_FIELDS` is the layout. Every number is divided by a fixed scale, so that it is of order one. The scales are
powers of two, so the division has no rounding error. The tracking error is the error of the flat outputs in the world
frame, as in the paper, (F_x − F_xd, F_y − F_yd, z − z_d): its horizontal part is that of the bob, its vertical part
that of the quadrotor. ψ_e = ψ − ψ_d. The observation does not contain the wind.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import inlined
from quadpend_gym.core.settings import look_up
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, POSITION, VELOCITY
from quadpend_gym.physics.vectors import Vec3, axpy, load, store
from quadpend_gym.tasks.references import ReferencePoint

_SCALES: dict[str, tuple[float, float, float]] = {
    "tracking_error": (0.5, 0.5, 0.5),  # e, m
    "tracking_error_rate": (1.0, 1.0, 1.0),  # ė, m/s
    "direction": (0.25, 0.25, 1.0),  # r
    "direction_rate": (1.0, 1.0, 1.0),  # ṙ, 1/s
    "attitude": (0.25, 0.25, 0.25),  # φ, θ, ψ_e, rad
    "euler_rate": (2.0, 2.0, 2.0),  # φ̇, θ̇, ψ̇, rad/s
    "reference_2": (1.0, 1.0, 1.0),  # F_d⁽²⁾, m/s²
    "reference_3": (2.0, 2.0, 2.0),  # F_d⁽³⁾, m/s³
    "reference_4": (4.0, 4.0, 4.0),  # F_d⁽⁴⁾, m/s⁴
    "reference_5": (8.0, 8.0, 8.0),  # F_d⁽⁵⁾, m/s⁵
    "reference_6": (16.0, 16.0, 16.0),  # F_d⁽⁶⁾, m/s⁶
    "yaw_reference": (1.0, 1.0, 1.0),  # ψ_d, ψ̇_d, ψ̈_d, rad, rad/s, rad/s²
}
_RATES = ("tracking_error_rate", "direction_rate", "euler_rate")


def _layout(names: Iterable[str]) -> dict[str, slice]:
    return {name: slice(3 * i, 3 * i + 3) for i, name in enumerate(names)}


OBSERVATION_FIELDS = _layout(_SCALES)
OBSERVATION_SCALE: Floats = np.array(list(_SCALES.values())).ravel()
OBSERVATION_SIZE = OBSERVATION_SCALE.size
# The output-feedback observation has all fields except the rates.
OUTPUT_FEEDBACK_FIELDS = _layout(name for name in _SCALES if name not in _RATES)
OUTPUT_FEEDBACK_COLUMNS = np.concatenate([np.r_[OBSERVATION_FIELDS[name]] for name in OUTPUT_FEEDBACK_FIELDS])
OUTPUT_FEEDBACK_SIZE = OUTPUT_FEEDBACK_COLUMNS.size
_LAYOUTS = {OBSERVATION_SIZE: OBSERVATION_FIELDS, OUTPUT_FEEDBACK_SIZE: OUTPUT_FEEDBACK_FIELDS}
# The columns before this one depend on the state, the others on the reference only.
REFERENCE_START = OBSERVATION_FIELDS["reference_2"].start

# First column of each field, as constants that compiled functions can read.
_TRACKING_ERROR, _TRACKING_ERROR_RATE, _DIRECTION, _DIRECTION_RATE, _ATTITUDE, _EULER_RATE = range(0, 18, 3)
_REFERENCE_2, _REFERENCE_3, _REFERENCE_4, _REFERENCE_5, _REFERENCE_6, _YAW_REFERENCE = range(18, 36, 3)


def read_observation(observation: Floats32 | Floats, name: str) -> Floats:
    """Return one of `OBSERVATION_FIELDS` in physical units, shape (..., 3), float64.

    Observations have the shape (..., 36), or (..., 27) without velocities.
    """
    fields = _LAYOUTS.get(observation.shape[-1])
    if fields is None:
        raise ValueError(f"an observation has {' or '.join(map(str, _LAYOUTS))} numbers, not {observation.shape[-1]}")
    columns = look_up(fields, name, "field of the observation")
    return np.asarray(observation[..., columns] * OBSERVATION_SCALE[OBSERVATION_FIELDS[name]])


class Target(NamedTuple):
    """Reference values of the flat outputs (m), of their rates (m/s) and of the yaw (rad)."""

    position: Vec3
    velocity: Vec3
    yaw: float


TARGET_SIZE = 7
_TARGET_POSITION, _TARGET_VELOCITY, _TARGET_YAW = 0, 3, 6


@inlined
def load_target(lanes: Any, lane: int) -> Target:
    """Return the target in column `lane` of a (7, n) buffer."""
    return Target(load(lanes, _TARGET_POSITION, lane), load(lanes, _TARGET_VELOCITY, lane), lanes[_TARGET_YAW, lane])


@inlined
def store_target(target: Target, lanes: Any, lane: int) -> None:
    """Write a target into column `lane` of a (7, n) buffer."""
    store(lanes, _TARGET_POSITION, lane, target.position)
    store(lanes, _TARGET_VELOCITY, lane, target.velocity)
    lanes[_TARGET_YAW, lane] = target.yaw


class TrackingErrors(NamedTuple):
    """Error of the flat outputs (m), its rate (m/s), and error of the yaw (rad)."""

    error: Vec3
    error_rate: Vec3
    yaw_error: float


@inlined
def tracking_errors(state: Any, lane: int, rod_length: float, target: Target) -> TrackingErrors:
    """Return the tracking errors of the state in column `lane` of an (18, n) buffer; that of the yaw is in [−π, π]."""
    position, velocity = load(state, POSITION, lane), load(state, VELOCITY, lane)
    bob = axpy(rod_length, load(state, DIRECTION, lane), position)
    bob_rate = axpy(rod_length, load(state, DIRECTION_RATE, lane), velocity)
    wanted, wanted_rate = target.position, target.velocity
    error = Vec3(bob.x - wanted.x, bob.y - wanted.y, position.z - wanted.z)
    error_rate = Vec3(bob_rate.x - wanted_rate.x, bob_rate.y - wanted_rate.y, velocity.z - wanted_rate.z)
    turned = load(state, EULER, lane).z - target.yaw
    return TrackingErrors(error, error_rate, turned - 2.0 * np.pi * np.rint(turned / (2.0 * np.pi)))


_RECIPROCAL = (1.0 / OBSERVATION_SCALE).astype(np.float32)


@inlined
def _store_scaled(out: Any, first: int, lane: int, a: Vec3) -> None:
    for i in range(3):
        out[first + i, lane] = np.float32(a[i]) * _RECIPROCAL[first + i]


@inlined
def observe_state(state: Any, lane: int, tracking: TrackingErrors, out: Any, place: int) -> None:
    """Write the fields that depend on the state in column `lane` of an (18, n) buffer, true or measured.

    `tracking` are its tracking errors; the fields are written into column `place` of a (36, m) float32 buffer.
    """
    euler = load(state, EULER, lane)
    attitude = Vec3(euler.x, euler.y, tracking.yaw_error)
    _store_scaled(out, _TRACKING_ERROR, place, tracking.error)
    _store_scaled(out, _TRACKING_ERROR_RATE, place, tracking.error_rate)
    _store_scaled(out, _DIRECTION, place, load(state, DIRECTION, lane))
    _store_scaled(out, _DIRECTION_RATE, place, load(state, DIRECTION_RATE, lane))
    _store_scaled(out, _ATTITUDE, place, attitude)
    _store_scaled(out, _EULER_RATE, place, load(state, EULER_RATE, lane))


@inlined
def observe_reference(reference: ReferencePoint, lane: int, out: Any) -> None:
    """Write the fields that depend on the reference only into column `lane` of a (36, n) float32 buffer."""
    _store_scaled(out, _REFERENCE_2, lane, reference.d2)
    _store_scaled(out, _REFERENCE_3, lane, reference.d3)
    _store_scaled(out, _REFERENCE_4, lane, reference.d4)
    _store_scaled(out, _REFERENCE_5, lane, reference.d5)
    _store_scaled(out, _REFERENCE_6, lane, reference.d6)
    _store_scaled(out, _YAW_REFERENCE, lane, Vec3(reference.yaw, reference.yaw_rate, reference.yaw_acceleration))
