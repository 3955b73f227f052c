"""The observation: 36 numbers, float32, scaled by fixed constants to order one. All that any policy sees.

`OBSERVATION_FIELDS` is the layout; the scales are powers of two, so that scaling is exact. The tracking error is the
error of the flat outputs, (F_x − F_xd, F_y − F_yd, z − z_d): horizontally the bob's, vertically the quadrotor's, in the
world frame, as in the paper. ψ_e = ψ − ψ_d. No wind is in it.

| name                 | symbol          | size | unit       | scale        |
|----------------------|-----------------|------|------------|--------------|
| tracking_error       | e               | 3    | m          | ½            |
| tracking_error_rate  | ė               | 3    | m/s        | 1            |
| direction            | r               | 3    | 1          | ¼, ¼, 1      |
| direction_rate       | ṙ               | 3    | 1/s        | 1            |
| attitude             | φ, θ, ψ_e       | 3    | rad        | ¼            |
| euler_rate           | φ̇, θ̇, ψ̇         | 3    | rad/s      | 2            |
| reference_2 … _6     | F_d⁽²⁾ … F_d⁽⁶⁾ | 3 each | m/s² … m/s⁶ | 1, 2, 4, 8, 16 |
| yaw_reference        | ψ_d, ψ̇_d, ψ̈_d   | 3    | rad …      | 1            |
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, POSITION, VELOCITY
from quadpend_gym.physics.vectors import Vec3, axpy, load, store
from quadpend_gym.tasks.references import ReferencePoint

# name: scale of each component, in the order of the layout
_SCALES: dict[str, tuple[float, float, float]] = {
    "tracking_error": (0.5, 0.5, 0.5),
    "tracking_error_rate": (1.0, 1.0, 1.0),
    "direction": (0.25, 0.25, 1.0),
    "direction_rate": (1.0, 1.0, 1.0),
    "attitude": (0.25, 0.25, 0.25),
    "euler_rate": (2.0, 2.0, 2.0),
    "reference_2": (1.0, 1.0, 1.0),
    "reference_3": (2.0, 2.0, 2.0),
    "reference_4": (4.0, 4.0, 4.0),
    "reference_5": (8.0, 8.0, 8.0),
    "reference_6": (16.0, 16.0, 16.0),
    "yaw_reference": (1.0, 1.0, 1.0),
}
OBSERVATION_FIELDS = {name: slice(3 * i, 3 * i + 3) for i, name in enumerate(_SCALES)}
OBSERVATION_SCALE: Floats = np.array(list(_SCALES.values())).ravel()
OBSERVATION_SIZE = OBSERVATION_SCALE.size
# Of an output-feedback observation: all but the rates, which nobody measures there.
OUTPUT_FEEDBACK_FIELDS = {
    name: slice(3 * i, 3 * i + 3)
    for i, name in enumerate(
        name for name in _SCALES if name not in ("tracking_error_rate", "direction_rate", "euler_rate")
    )
}
OUTPUT_FEEDBACK_COLUMNS = np.concatenate([np.r_[OBSERVATION_FIELDS[name]] for name in OUTPUT_FEEDBACK_FIELDS])
OUTPUT_FEEDBACK_SIZE = OUTPUT_FEEDBACK_COLUMNS.size
_LAYOUTS = {OBSERVATION_SIZE: OBSERVATION_FIELDS, OUTPUT_FEEDBACK_SIZE: OUTPUT_FEEDBACK_FIELDS}
REFERENCE_START = OBSERVATION_FIELDS["reference_2"].start  # what comes of the state stands before it

_TRACKING_ERROR = OBSERVATION_FIELDS["tracking_error"].start
_TRACKING_ERROR_RATE = OBSERVATION_FIELDS["tracking_error_rate"].start
_DIRECTION = OBSERVATION_FIELDS["direction"].start
_DIRECTION_RATE = OBSERVATION_FIELDS["direction_rate"].start
_ATTITUDE = OBSERVATION_FIELDS["attitude"].start
_EULER_RATE = OBSERVATION_FIELDS["euler_rate"].start
_REFERENCE = OBSERVATION_FIELDS["reference_2"].start
_YAW_REFERENCE = OBSERVATION_FIELDS["yaw_reference"].start


def read_observation(observation: Floats32 | Floats, name: str) -> Floats:
    """One field of an observation in physical units, shape (..., 3), float64.

    Args:
        observation: shape (..., 36), or (..., 27) as `OutputFeedbackWrapper` leaves it.
        name: a key of `OBSERVATION_FIELDS`.

    Raises:
        ValueError: the observation has another size, or no such field.
    """
    fields = _LAYOUTS.get(observation.shape[-1])
    if fields is None:
        raise ValueError(f"an observation has {' or '.join(map(str, _LAYOUTS))} numbers, not {observation.shape[-1]}")
    if name not in fields:
        raise ValueError(f"this observation has no {name!r}; it has {', '.join(fields)}")
    return np.asarray(observation[..., fields[name]] * OBSERVATION_SCALE[OBSERVATION_FIELDS[name]])


class Target(NamedTuple):
    """Where the flat outputs (m), their rates (m/s) and the yaw (rad) should be."""

    position: Vec3
    velocity: Vec3
    yaw: float


TARGET_SIZE = 7


@inlined
def load_target(lanes: Any, lane: int) -> Target:
    """The target in column `lane` of a (7, n) buffer."""
    return Target(load(lanes, 0, lane), load(lanes, 3, lane), lanes[6, lane])


@inlined
def store_target(target: Target, lanes: Any, lane: int) -> None:
    """Write a target into column `lane` of a (7, n) buffer."""
    store(lanes, 0, lane, target.position)
    store(lanes, 3, lane, target.velocity)
    lanes[6, lane] = target.yaw


class TrackingErrors(NamedTuple):
    """How well the reference is tracked: flat-output error (m), its rate (m/s), yaw error (rad)."""

    error: Vec3
    error_rate: Vec3
    yaw_error: float


@inlined
def tracking_errors(state: Any, lane: int, rod_length: float, target: Target) -> TrackingErrors:
    """Tracking errors of the state in column `lane` of an (18, n) buffer."""
    bob = axpy(rod_length, load(state, DIRECTION, lane), load(state, POSITION, lane))
    bob_rate = axpy(rod_length, load(state, DIRECTION_RATE, lane), load(state, VELOCITY, lane))
    should, rate = target.position, target.velocity
    error = Vec3(bob.x - should.x, bob.y - should.y, state[POSITION + 2, lane] - should.z)
    error_rate = Vec3(bob_rate.x - rate.x, bob_rate.y - rate.y, state[VELOCITY + 2, lane] - rate.z)
    return TrackingErrors(error, error_rate, state[EULER + 2, lane] - target.yaw)


_RECIPROCAL = (1.0 / OBSERVATION_SCALE).astype(np.float32)


@inlined
def _store_scaled(out: Any, first: int, lane: int, a: Vec3) -> None:
    for i in range(3):
        out[first + i, lane] = np.float32(a[i]) * _RECIPROCAL[first + i]


@inlined
def observe_state(state: Any, lane: int, tracking: TrackingErrors, out: Any, place: int) -> None:
    """Write what the observation has of the state in column `lane`, true or sensed, into column `place` of `out`."""
    attitude = Vec3(state[EULER, lane], state[EULER + 1, lane], tracking.yaw_error)
    _store_scaled(out, _TRACKING_ERROR, place, tracking.error)
    _store_scaled(out, _TRACKING_ERROR_RATE, place, tracking.error_rate)
    _store_scaled(out, _DIRECTION, place, load(state, DIRECTION, lane))
    _store_scaled(out, _DIRECTION_RATE, place, load(state, DIRECTION_RATE, lane))
    _store_scaled(out, _ATTITUDE, place, attitude)
    _store_scaled(out, _EULER_RATE, place, load(state, EULER_RATE, lane))


@inlined
def observe_reference(reference: ReferencePoint, lane: int, out: Any) -> None:
    """Write what the observation has of the reference into column `lane` of a (36, n) float32 buffer."""
    _store_scaled(out, _REFERENCE, lane, reference.d2)
    _store_scaled(out, _REFERENCE + 3, lane, reference.d3)
    _store_scaled(out, _REFERENCE + 6, lane, reference.d4)
    _store_scaled(out, _REFERENCE + 9, lane, reference.d5)
    _store_scaled(out, _REFERENCE + 12, lane, reference.d6)
    _store_scaled(out, _YAW_REFERENCE, lane, Vec3(reference.yaw, reference.yaw_rate, reference.yaw_acceleration))
