"""Trajectories: sinusoids (`Reference`), and waypoints with times.

A trajectory gives the four channels F_x, F_y, z and ψ as functions of time, see `references`, with exact derivatives of
order 0 to 6:

    (1)  Waypoints:  Σₖ cᵢₖ (t − tᵢ)ᵏ in piece i, k = 0 … 13, see `minimum_snap`
    (2)  Reference:  offset + rate · t + amplitude · sin(frequency · t + phase)

Waypoints rest at the first point before the first time and at the last point after the last time; closed ones repeat.

Packed waypoints are a flat array. Many of them stand one after the other in the array that compiled functions read.

| part        | numbers    | content                                                                      |
|-------------|------------|------------------------------------------------------------------------------|
| header      | 2          | period in s (0: not periodic), number of pieces m                            |
| origins     | m          | tᵢ in s: piece i holds until tᵢ₊₁, the first one from −∞ and the last one to ∞ |
| polynomials | m · 4 · 14 | cᵢₖ of each channel                                                          |
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.settings import Parsed, Range, look_up, parse, settings
from quadpend_gym.physics.vectors import Vec3
from quadpend_gym.tasks.minimum_snap import COEFFICIENTS, minimum_snap
from quadpend_gym.tasks.references import (
    CHANNELS,
    LARGEST,
    ORDERS,
    POINT_SIZE,
    REFERENCE_SIZE,
    Channels,
    Derivatives,
    ReferencePoint,
    channel_derivatives,
    store_point,
)

SHORTEST_INTERVAL = 0.01  # s, between two waypoints
LARGEST_RATIO = 1000.0  # of the longest interval to the shortest
_HEADER = 2
_PERIOD, _PIECES = range(_HEADER)


@inlined
def _polynomial(numbers: Any, first: int, t: float) -> Derivatives:
    """Return a polynomial and its derivatives at `t`; its coefficients begin at numbers[first]."""
    d0, d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # the derivatives, divided by factorials
    for k in range(COEFFICIENTS - 1, -1, -1):  # Horner's rule
        d6 = d6 * t + d5
        d5 = d5 * t + d4
        d4 = d4 * t + d3
        d3 = d3 * t + d2
        d2 = d2 * t + d1
        d1 = d1 * t + d0
        d0 = d0 * t + numbers[first + k]
    return d0, d1, 2.0 * d2, 6.0 * d3, 24.0 * d4, 120.0 * d5, 720.0 * d6


@inlined
def _waypoints_channel(numbers: Any, first: int, channel: int, time: float) -> Derivatives:
    """Return a channel of the packed waypoints that begin at numbers[first]."""
    pieces, origins = int(numbers[first + _PIECES]), first + _HEADER
    t, period = time, numbers[first + _PERIOD]
    if period > 0.0:
        t -= period * np.floor(t / period)
    piece, end = 0, pieces
    while end - piece > 1:  # bisection
        middle = (piece + end) // 2
        if t >= numbers[origins + middle]:
            piece = middle
        else:
            end = middle
    place = origins + pieces + (piece * CHANNELS + channel) * COEFFICIENTS
    return _polynomial(numbers, place, t - numbers[origins + piece])


@inlined
def followed_at(numbers: Any, first: int, time: float) -> ReferencePoint:
    """Return the point of the packed waypoints that begin at numbers[first], at `time` (s)."""
    x = _waypoints_channel(numbers, first, 0, time)
    y = _waypoints_channel(numbers, first, 1, time)
    z = _waypoints_channel(numbers, first, 2, time)
    yaw = _waypoints_channel(numbers, first, 3, time)
    return _point(x, y, z, yaw)


@inlined
def reference_at(lanes: Any, lane: int, time: float) -> ReferencePoint:
    """Return the point of the `Reference` in column `lane` of a (20, m) buffer, at `time` (s)."""
    x = channel_derivatives(lanes, 0, lane, time)
    y = channel_derivatives(lanes, 1, lane, time)
    z = channel_derivatives(lanes, 2, lane, time)
    yaw = channel_derivatives(lanes, 3, lane, time)
    return _point(x, y, z, yaw)


@inlined
def _point(x: Derivatives, y: Derivatives, z: Derivatives, yaw: Derivatives) -> ReferencePoint:
    return ReferencePoint(
        Vec3(x[0], y[0], z[0]),
        Vec3(x[1], y[1], z[1]),
        Vec3(x[2], y[2], z[2]),
        Vec3(x[3], y[3], z[3]),
        Vec3(x[4], y[4], z[4]),
        Vec3(x[5], y[5], z[5]),
        Vec3(x[6], y[6], z[6]),
        yaw[0],
        yaw[1],
        yaw[2],
    )


@compiled
def _follow(numbers: Floats, first: Integers, time: Floats, points: Floats) -> None:
    for row in range(first.shape[0]):
        if first[row] >= 0:
            store_point(followed_at(numbers, first[row], time[row]), row, points)


@compiled
def _evaluate_waypoints(numbers: Floats, time: Floats, out: Floats) -> None:
    for i in range(time.shape[0]):
        for channel in range(CHANNELS):
            derivatives = _waypoints_channel(numbers, 0, channel, time[i])
            for order in range(ORDERS):
                out[i, order, channel] = derivatives[order]


@compiled
def _evaluate_reference(numbers: Floats, time: Floats, out: Floats) -> None:
    lanes = numbers.reshape((REFERENCE_SIZE, 1))
    for i in range(time.shape[0]):
        for channel in range(CHANNELS):
            derivatives = channel_derivatives(lanes, channel, 0, time[i])
            for order in range(ORDERS):
                out[i, order, channel] = derivatives[order]


def _with_yaw(point: Any) -> Any:
    if not isinstance(point, tuple) or len(point) not in (CHANNELS - 1, CHANNELS):
        raise ValueError(f"each of the points must be (x, y, z) or (x, y, z, yaw) in m and rad, not {point!r}")
    return (*point, 0.0)[:CHANNELS]


Point = Annotated[tuple[float, float, float, float], BeforeValidator(_with_yaw)]


class _Packed:
    """Mixin for trajectories that a compiled function `_evaluate` computes from the array `packed`."""

    _evaluate: Any
    packed: Any

    def derivatives(self, time: Any) -> Floats:
        """Return the derivatives of order 0 to 6 of all channels at `time` (s), shape (*time.shape, 7, 4)."""
        times = np.asarray(time, np.float64)
        out = np.empty((times.size, ORDERS, CHANNELS))
        self._evaluate(self.packed, times.ravel(), out)
        return out.reshape(*times.shape, ORDERS, CHANNELS)


@settings
class Reference(_Packed):
    """A constant velocity plus a sinusoid, equation (2).

    Every field has one number for each channel: F_x (m), F_y (m), z (m) and ψ (rad).
    """

    # constant part in each channel (F_x, F_y, z, ψ)
    offset: Annotated[Channels, Range(-LARGEST, LARGEST, "m and rad")] = (0.0, 0.0, 2.0, 0.0)
    # constant velocity in each channel
    rate: Annotated[Channels, Range(-LARGEST, LARGEST, "m/s and rad/s")] = (0.0, 0.0, 0.0, 0.0)
    # amplitude of the sinusoid in each channel
    amplitude: Annotated[Channels, Range(-LARGEST, LARGEST, "m and rad")] = (0.0, 0.0, 0.0, 0.0)
    # angular frequency in each channel
    frequency: Annotated[Channels, Range(-LARGEST, LARGEST, "rad/s")] = (0.0, 0.0, 0.0, 0.0)
    phase: Annotated[Channels, Range(-LARGEST, LARGEST, "rad")] = (0.0, 0.0, 0.0, 0.0)  # phase in each channel
    kind: Literal["sinusoids"] = "sinusoids"
    _evaluate = staticmethod(_evaluate_reference)

    @classmethod
    def hover(cls, x: float = 0.0, y: float = 0.0, z: float = 2.0, yaw: float = 0.0) -> "Reference":
        """Return a constant reference: a point (m) and a yaw angle (rad)."""
        return cls(offset=(x, y, z, yaw))

    @classmethod
    def circle(cls, radius: float, frequency: float, height: float = 2.0, climb: float = 0.0) -> "Reference":
        """Return a horizontal circle around the z axis, or a helix with a vertical velocity, in SI units.

        With a negative angular frequency the motion is clockwise, seen from above. The height is that at time zero.
        """
        return cls(
            offset=(0.0, 0.0, height, 0.0),
            rate=(0.0, 0.0, climb, 0.0),
            amplitude=(radius, radius, 0.0, 0.0),
            frequency=(frequency, frequency, 0.0, 0.0),
            phase=(np.pi / 2, 0.0, 0.0, 0.0),
        )

    @classmethod
    def figure_eight(cls, radius: float, frequency: float, height: float = 2.0) -> "Reference":
        """Return a horizontal figure eight with half of its length (m), angular frequency (rad/s) and height (m)."""
        return cls(
            offset=(0.0, 0.0, height, 0.0),
            amplitude=(radius, radius / 2, 0.0, 0.0),
            frequency=(frequency, 2 * frequency, 0.0, 0.0),
        )

    @classmethod
    def from_array(cls, array: Floats) -> "Reference":
        """Return the reference of an array from `as_array`, without checks, since a task may draw larger numbers."""
        reference = cls()
        for field, values in zip(fields(cls), array.reshape(-1, CHANNELS).tolist(), strict=False):
            object.__setattr__(reference, field.name, tuple(values))
        return reference

    def as_array(self) -> Floats:
        """Return the fields in order as an array of shape (20,)."""
        return np.ravel((self.offset, self.rate, self.amplitude, self.frequency, self.phase))

    @cached_property
    def packed(self) -> Floats:
        """The fields as an array."""
        return self.as_array()

    def sample_times(self) -> Floats:
        """Return times that resolve the sinusoids, over 10 s to 100 s, s, shape (k,); one time without sinusoids."""
        moving = np.abs(self.frequency)[np.not_equal(self.frequency, 0.0)]
        if not moving.size:
            return np.zeros(1)
        horizon = np.clip(2.0 * np.pi / moving.min(), 10.0, 100.0)
        return np.linspace(0.0, horizon, int(np.clip(horizon * max(50.0, 7.0 * moving.max()), 1, 20_000)))


@settings
class Waypoints(_Packed):
    """A smooth trajectory through given points at given times, equation (1), from rest to rest.

    It is a minimum-snap spline whose derivatives of order 0 to 6 are continuous, see `minimum_snap`.
    """

    times: Annotated[tuple[float, ...], Range(0.0, LARGEST, "s")]  # time of each point; the first is 0
    # (F_x, F_y, z) or (F_x, F_y, z, ψ) at each time
    points: Annotated[tuple[Point, ...], Range(-LARGEST, LARGEST, "m and rad")]
    closed: bool = False  # whether the trajectory repeats without stopping; the last point must equal the first
    kind: Literal["waypoints"] = "waypoints"
    _evaluate = staticmethod(_evaluate_waypoints)

    def __post_init__(self) -> None:
        if len(self.times) < 2 or self.times[0] != 0.0:
            raise ValueError(f"times must be at least two numbers that begin with 0, not {self.times}")
        intervals = np.diff(self.times)
        shortest, longest = intervals.min(), intervals.max()
        if shortest < SHORTEST_INTERVAL * (1.0 - 1e-9) or longest > LARGEST_RATIO * shortest:
            raise ValueError(
                f"times must increase by at least {SHORTEST_INTERVAL:g} s, and by at most {LARGEST_RATIO:g} times the"
                f" shortest interval, not by {shortest:g} s to {longest:g} s"
            )
        if len(self.points) != len(self.times):
            raise ValueError(
                f"points must be {len(self.times)} points, as many as the times, not {len(self.points)} points"
            )
        if self.closed and self.points[0] != self.points[-1]:
            raise ValueError(
                f"the last point of closed waypoints must equal the first, {self.points[0]}, not {self.points[-1]}"
            )

    @cached_property
    def packed(self) -> Floats:
        """The packed waypoints, shape (k,)."""
        times, points = np.array(self.times), np.array(self.points)
        origins, coefficients = times[:-1], minimum_snap(times, points, self.closed)
        if not self.closed:  # a piece at rest before the first time, and one after the last time
            rest = np.zeros((2, CHANNELS, COEFFICIENTS))
            rest[:, :, 0] = points[0], points[-1]
            origins = np.concatenate([times[:1], times])
            coefficients = np.concatenate([rest[:1], coefficients, rest[1:]])
        header = [times[-1] if self.closed else 0.0, len(origins)]
        return np.concatenate([header, origins, coefficients.ravel()])

    def sample_times(self) -> Floats:
        """Return times that resolve the whole trajectory, s, shape (k,)."""
        pairs = zip(self.times, self.times[1:], strict=False)
        return np.concatenate([np.linspace(a, b, max(41, int((b - a) / 0.02))) for a, b in pairs])


Trajectory = Reference | Waypoints
KINDS: dict[str, type[Waypoints] | type[Reference]] = {"waypoints": Waypoints, "sinusoids": Reference}


def as_trajectory(value: Any, name: str) -> Trajectory:
    """Return a trajectory from one or from a mapping of its fields, without a ``kind`` those of `Reference`.

    Error messages call it `name`.
    """
    if isinstance(value, Trajectory):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a Reference, Waypoints or a mapping of the fields of either, not {value!r}")
    if "kind" not in value:
        return parse(Reference, value, name)
    return parse(look_up(KINDS, value["kind"], f"{name} of the kind"), value, name)


# Annotation of a field that holds a trajectory or None
TrajectoryField = Parsed(
    lambda value: None if value is None else as_trajectory(value, "trajectory"), lambda: Trajectory | None
)


_NO_POINTS = np.empty((POINT_SIZE, 0))


class TrajectoryTable:
    """Waypoints that n sub-environments follow, packed; each object is stored once.

    Attributes:
        numbers: Packed waypoints, one after the other, shape (k,).
        first: Position in `numbers` of the waypoints of each sub-environment, shape (n,); −1: a `Reference`.
    """

    def __init__(self, rows: int) -> None:
        self.numbers, self.first = np.zeros(0), np.full(rows, -1, np.int64)
        self._followed: list[Trajectory | None] = [None] * rows

    def assign(self, rows: Integers, trajectories: Sequence[Trajectory | None]) -> bool:
        """Set the trajectories of the sub-environments `rows`, shape (m,), and return whether this changed any.

        There is one trajectory for all of them or one for each; None for a sub-environment without one.
        """
        new = dict(zip(rows.tolist(), list(trajectories) * (len(rows) // len(trajectories)), strict=True))
        if all(self._followed[row] is item for row, item in new.items()):
            return False
        for row, item in new.items():
            self._followed[row] = item
        distinct = {id(item): item.packed for item in self._followed if item is not None}
        ends = np.cumsum([0, *(packed.size for packed in distinct.values())])
        position = dict(zip(distinct, ends.tolist(), strict=False))
        self.first[:] = [position.get(id(item), -1) for item in self._followed]
        self.numbers = np.concatenate([np.zeros(0), *distinct.values()])
        return True

    def points(self, rows: Any, clock: Integers, period: float, later: int = 0) -> Floats:
        """Return the points of the sub-environments `rows` as an array of shape (24, m).

        Without a trajectory of any sub-environment, its shape is (24, 0). Else numbers of sub-environments without one
        are not set.

        Args:
            rows: Indices, shape (m,).
            clock: Their control steps since the episodes began, shape (m,).
            period: Control period, s.
            later: Further control steps until the time of the points.
        """
        if not self.numbers.size:
            return _NO_POINTS
        points = np.empty((POINT_SIZE, clock.size))
        _follow(self.numbers, self.first[rows], np.asarray(period * (clock + later), np.float64), points)
        return points

    def find(self, row: int) -> Trajectory | None:
        """Return the trajectory of a sub-environment, or None if it follows none."""
        return self._followed[row]
