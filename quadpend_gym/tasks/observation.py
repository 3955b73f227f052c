"""The observation: fields by name, float32, each with a scale.

`FIELDS` is the table of all fields, and an `ObservationLayout` the names of those that an observation has, in their
order; `PRESETS` has layouts by name. Every number is divided by a fixed scale, so that it is of order one. The scales
are powers of two, so the division has no rounding error. The tracking error is the error of the flat outputs in the
world frame, as in the paper, (F_x − F_xd, F_y − F_yd, z − z_d): its horizontal part is that of the bob, its vertical
part that of the quadrotor. ψ_e = ψ − ψ_d. The observation does not contain the wind.

`full` and `output_feedback` have the errors of the true pole. A lab does not know that pole: the preset `lab` has what
it measures (position, attitude, direction of the pole, and how old the sample is), the whole reference, and the pole
that is believed. Errors are then the policy's own. The sign of the quaternion does not change while the yaw turns; only
a body that is upside down can change it.

A further field is a row at the end of the table and a line in a function that writes observations.
"""

from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import inlined
from quadpend_gym.core.settings import Parsed, look_up
from quadpend_gym.physics.attitude import quaternion_from_euler
from quadpend_gym.physics.state import DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, POSITION, VELOCITY
from quadpend_gym.physics.vectors import Vec3, axpy, load, store
from quadpend_gym.tasks.references import ReferencePoint


class ObservationField(NamedTuple):
    """A field of the observation: symbol, unit and frame of its numbers, and the scales that divide them."""

    symbol: str
    unit: str
    frame: str
    scale: tuple[float, ...]
    source: Literal["state", "reference", "pole"]  # on which it depends; the state is that of the sensors


FIELDS: dict[str, ObservationField] = {
    "tracking_error": ObservationField("e", "m", "world", (0.5, 0.5, 0.5), "state"),
    "tracking_error_rate": ObservationField("ė", "m/s", "world", (1.0, 1.0, 1.0), "state"),
    "direction": ObservationField("r", "1", "world", (0.25, 0.25, 1.0), "state"),
    "direction_rate": ObservationField("ṙ", "1/s", "world", (1.0, 1.0, 1.0), "state"),
    "attitude": ObservationField("φ, θ, ψ_e", "rad", "Euler angles", (0.25, 0.25, 0.25), "state"),
    "euler_rate": ObservationField("φ̇, θ̇, ψ̇", "rad/s", "Euler angles", (2.0, 2.0, 2.0), "state"),
    "reference_2": ObservationField("F_d⁽²⁾", "m/s²", "world", (1.0, 1.0, 1.0), "reference"),
    "reference_3": ObservationField("F_d⁽³⁾", "m/s³", "world", (2.0, 2.0, 2.0), "reference"),
    "reference_4": ObservationField("F_d⁽⁴⁾", "m/s⁴", "world", (4.0, 4.0, 4.0), "reference"),
    "reference_5": ObservationField("F_d⁽⁵⁾", "m/s⁵", "world", (8.0, 8.0, 8.0), "reference"),
    "reference_6": ObservationField("F_d⁽⁶⁾", "m/s⁶", "world", (16.0, 16.0, 16.0), "reference"),
    "yaw_reference": ObservationField("ψ_d, ψ̇_d, ψ̈_d", "rad, rad/s, rad/s²", "world", (1.0, 1.0, 1.0), "reference"),
    "position": ObservationField("ζ", "m", "world", (1.0, 1.0, 1.0), "state"),
    "quaternion": ObservationField("q", "1", "body to world, order w, x, y, z", (1.0, 1.0, 1.0, 1.0), "state"),
    "age": ObservationField("age of the sample", "s", "", (0.125,), "state"),
    "reference_0": ObservationField("F_d", "m", "world", (1.0, 1.0, 1.0), "reference"),
    "reference_1": ObservationField("F_d⁽¹⁾", "m/s", "world", (1.0, 1.0, 1.0), "reference"),
    "pole": ObservationField("l, m as believed", "m, kg", "", (0.5, 0.25), "pole"),
}


class ObservationLayout(tuple[str, ...]):
    """The names of the fields of an observation, in their order, and how to read it by them."""

    @cached_property
    def columns(self) -> dict[str, slice]:
        """The columns of each field."""
        ends = np.cumsum([0, *(len(FIELDS[name].scale) for name in self)]).tolist()
        return {name: slice(*pair) for name, pair in zip(self, pairwise(ends), strict=True)}

    @cached_property
    def scale(self) -> Floats:
        """The scale of each number, shape (size,)."""
        return np.concatenate([FIELDS[name].scale for name in self])

    @property
    def size(self) -> int:
        """Number of numbers of an observation."""
        return int(self.scale.size)

    def select(self, names: Iterable[str]) -> Any:
        """Return the columns of fields in the order of their names: a slice where they are next to each other."""
        columns = np.concatenate([np.r_[look_up(self.columns, name, "field of the observation")] for name in names])
        return slice(int(columns[0]), int(columns[-1]) + 1) if (np.diff(columns) == 1).all() else columns

    def check(self, observation: Floats32 | Floats) -> None:
        """Refuse observations, shape (..., m), of another size."""
        if np.shape(observation)[-1] != self.size:
            raise ValueError(
                f"an observation of {', '.join(self)} has {self.size} numbers, not {np.shape(observation)[-1]}"
            )

    def read(self, observation: Floats32 | Floats, name: str) -> Floats:
        """Return a field of observations, shape (..., size), in physical units, shape (..., k), float64."""
        self.check(observation)
        columns = look_up(self.columns, name, "field of the observation")
        return np.asarray(observation[..., columns] * self.scale[columns])


FULL = ObservationLayout(
    (
        *("tracking_error", "tracking_error_rate", "direction", "direction_rate", "attitude", "euler_rate"),
        *("reference_2", "reference_3", "reference_4", "reference_5", "reference_6", "yaw_reference"),
    )
)
OUTPUT_FEEDBACK = ObservationLayout(name for name in FULL if not name.endswith("_rate"))  # no velocities
LAB = ObservationLayout(
    (
        *("position", "quaternion", "direction", "age", "reference_0", "reference_1"),
        *("reference_2", "reference_3", "reference_4", "reference_5", "reference_6", "yaw_reference", "pole"),
    )
)
PRESETS = {"full": FULL, "output_feedback": OUTPUT_FEEDBACK, "lab": LAB}


def as_layout(value: Any) -> ObservationLayout:
    """Return the layout of a preset by its name, or of a list of fields."""
    if isinstance(value, str):
        return look_up(PRESETS, value, "preset of the observation", more=", or give a list of fields")
    if not isinstance(value, list | tuple) or not value or not all(isinstance(name, str) for name in value):
        raise ValueError(
            f"the observation must be {' or '.join(map(repr, PRESETS))}, or a list of fields, not {value!r}"
        )
    for name in value:
        look_up(FIELDS, name, "field of the observation")
    if len(set(value)) < len(value):
        raise ValueError(f"the observation must have each field once, not {list(value)}")
    return ObservationLayout(value)


def _accepted() -> Any:
    presets: Any = Literal[tuple(PRESETS)]
    names: Any = Literal[tuple(FIELDS)]
    return presets | list[names]


ObservationSetting = Parsed(as_layout, _accepted)


def read_observation(observation: Floats32 | Floats, name: str, fields: Any = FULL) -> Floats:
    """Return a field of observations, shape (..., m), in physical units, shape (..., k), float64.

    `fields` are those of the observation: `Scenario.observation`, the name of a preset, or a list.
    """
    return as_layout(fields).read(observation, name)


# All fields: those of `FULL` and then the others, which are computed where a scenario observes one of them.
ALL = ObservationLayout(FIELDS)


def _state_columns(layout: ObservationLayout) -> Any:
    return np.concatenate([np.r_[layout.columns[name]] for name in layout if FIELDS[name].source == "state"])


STATE_COLUMNS, LAB_STATE_COLUMNS = _state_columns(FULL), _state_columns(ALL)[_state_columns(FULL).size :]
OBSERVATION_FIELDS, OBSERVATION_SCALE, OBSERVATION_SIZE = FULL.columns, FULL.scale, FULL.size
OUTPUT_FEEDBACK_FIELDS, OUTPUT_FEEDBACK_SIZE = OUTPUT_FEEDBACK.columns, OUTPUT_FEEDBACK.size
OUTPUT_FEEDBACK_COLUMNS = FULL.select(OUTPUT_FEEDBACK)
# The columns of the full observation before this one depend on the state, the others on the reference only.
REFERENCE_START = OBSERVATION_FIELDS["reference_2"].start

# First column of each field, as constants that compiled functions can read.
_TRACKING_ERROR, _TRACKING_ERROR_RATE, _DIRECTION, _DIRECTION_RATE, _ATTITUDE, _EULER_RATE = (
    ALL.columns[name].start for name in FULL[:6]
)
_REFERENCE_2, _REFERENCE_3, _REFERENCE_4, _REFERENCE_5, _REFERENCE_6, _YAW_REFERENCE = (
    ALL.columns[name].start for name in FULL[6:]
)
_POSITION, _QUATERNION, _AGE, _REFERENCE_0, _REFERENCE_1, _POLE = (
    ALL.columns[name].start for name in ("position", "quaternion", "age", "reference_0", "reference_1", "pole")
)


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


_RECIPROCAL = (1.0 / ALL.scale).astype(np.float32)


@inlined
def _store_scaled(out: Any, first: int, lane: int, numbers: Any) -> None:
    for i in range(len(numbers)):
        out[first + i, lane] = np.float32(numbers[i]) * _RECIPROCAL[first + i]


@inlined
def observe_state(state: Any, lane: int, tracking: TrackingErrors, out: Any, place: int) -> None:
    """Write the fields of `FULL` that depend on the state in column `lane` of an (18, n) buffer, true or measured.

    `tracking` are its tracking errors; the fields are written into column `place` of an (m, n) float32 buffer with
    the rows of `ALL`.
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
    """Write the fields of `FULL` that depend on the reference only into column `lane` of such a buffer."""
    _store_scaled(out, _REFERENCE_2, lane, reference.d2)
    _store_scaled(out, _REFERENCE_3, lane, reference.d3)
    _store_scaled(out, _REFERENCE_4, lane, reference.d4)
    _store_scaled(out, _REFERENCE_5, lane, reference.d5)
    _store_scaled(out, _REFERENCE_6, lane, reference.d6)
    _store_scaled(out, _YAW_REFERENCE, lane, Vec3(reference.yaw, reference.yaw_rate, reference.yaw_acceleration))


@inlined
def observe_measured(state: Any, lane: int, age: float, out: Any, place: int) -> None:
    """Write the fields of `LAB` that depend on the measured state in column `lane`, and the age of the sample (s)."""
    _store_scaled(out, _POSITION, place, load(state, POSITION, lane))
    _store_scaled(out, _QUATERNION, place, quaternion_from_euler(load(state, EULER, lane)))
    out[_AGE, place] = np.float32(age) * _RECIPROCAL[_AGE]


@inlined
def observe_target(target: Target, length: float, mass: float, lane: int, out: Any) -> None:
    """Write the fields of `LAB` that depend on the reference, and the pole that is believed, l (m) and m (kg)."""
    _store_scaled(out, _REFERENCE_0, lane, target.position)
    _store_scaled(out, _REFERENCE_1, lane, target.velocity)
    _store_scaled(out, _POLE, lane, (length, mass))
