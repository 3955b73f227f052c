"""Trajectories of one's own: waypoints with times, and sums of sinusoids.

Like a `Reference`, a trajectory gives the four channels F_x, F_y, z and ψ as functions of time, with exact derivatives
of order 0 to 6:

    (1)  Waypoints:  Σₖ cᵢₖ (t − tᵢ)ᵏ in piece i, k = 0 … 13, see `minimum_snap`
    (2)  Sinusoids:  offset + rate · t + Σⱼ amplitudeⱼ · sin(frequencyⱼ · t + phaseⱼ)

Waypoints rest at the first point before the first time and at the last point after the last time; closed ones repeat.

A packed trajectory is a flat array. Many of them stand one after the other in the array that compiled functions read.

| part        | numbers    | content                                                                      |
|-------------|------------|------------------------------------------------------------------------------|
| header      | 3          | period in s (0: not periodic), number of pieces m, number of terms k          |
| origins     | m          | tᵢ in s: piece i holds until tᵢ₊₁, the first one from −∞ and the last one to ∞ |
| polynomials | m · 4 · 14 | cᵢₖ of each channel                                                          |
| terms       | k · 20     | each term as a reference array, offset and rate in the first                 |
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, NamedTuple, cast

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.ranges import Range, check_fields
from quadpend_gym.core.validation import as_vector, check_number, from_plain, suggest, to_plain_fields
from quadpend_gym.tasks.minimum_snap import COEFFICIENTS, minimum_snap
from quadpend_gym.tasks.references import (
    CHANNELS,
    LARGEST,
    ORDERS,
    REFERENCE_SIZE,
    Derivatives,
    Reference,
    ReferencePoint,
    channel_derivatives,
    channels_to_point,
    reference_point,
)

MOST_POINTS, MOST_TERMS = 200, 100
SHORTEST_INTERVAL = 0.01  # s, between two waypoints
LARGEST_RATIO = 1000.0  # of the longest interval to the shortest
_HEADER = 3
_PERIOD, _PIECES, _TERMS = range(_HEADER)


@inlined
def _add(a: Derivatives, b: Derivatives) -> Derivatives:
    return Derivatives(a.d0 + b.d0, a.d1 + b.d1, a.d2 + b.d2, a.d3 + b.d3, a.d4 + b.d4, a.d5 + b.d5, a.d6 + b.d6)


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
    return Derivatives(d0, d1, 2.0 * d2, 6.0 * d3, 24.0 * d4, 120.0 * d5, 720.0 * d6)


@inlined
def _trajectory_channel(numbers: Any, first: int, channel: int, time: float) -> Derivatives:
    """Return a channel of the packed trajectory that begins at numbers[first]."""
    pieces, terms = int(numbers[first + _PIECES]), int(numbers[first + _TERMS])
    origins = first + _HEADER
    polynomials = origins + pieces
    out = Derivatives(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if pieces > 0:
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
        place = polynomials + (piece * CHANNELS + channel) * COEFFICIENTS
        out = _polynomial(numbers, place, t - numbers[origins + piece])
    if terms > 0:
        begin = polynomials + pieces * CHANNELS * COEFFICIENTS
        columns = numbers[begin : begin + terms * REFERENCE_SIZE].reshape((terms, REFERENCE_SIZE)).T
        for term in range(terms):
            out = _add(out, channel_derivatives(columns, channel, term, time))
    return out


class PackedTrajectories(NamedTuple):
    """Trajectories of n sub-environments inside compiled functions.

    Attributes:
        numbers: Packed trajectories, one after the other, shape (k,).
        first: Position in `numbers` of the trajectory of each sub-environment, shape (n,); −1: it has a `Reference`.
    """

    numbers: Floats
    first: Integers


@inlined
def point_at(trajectories: Any, row: int, lanes: Any, lane: int, time: float) -> ReferencePoint:
    """Return the reference of sub-environment `row` at `time` (s).

    Args:
        trajectories: `PackedTrajectories`, or None if all sub-environments have a `Reference`.
        row: Number of the sub-environment.
        lanes: References, shape (20, m).
        lane: Column of `lanes` with the reference of the sub-environment.
        time: Time, s.
    """
    if trajectories is None:
        return reference_point(lanes, lane, time)
    numbers, first = trajectories.numbers, trajectories.first[row]
    if first < 0:
        return reference_point(lanes, lane, time)
    return channels_to_point(
        _trajectory_channel(numbers, first, 0, time),
        _trajectory_channel(numbers, first, 1, time),
        _trajectory_channel(numbers, first, 2, time),
        _trajectory_channel(numbers, first, 3, time),
    )


@compiled
def _evaluate(numbers: Floats, time: Floats, out: Floats) -> None:
    for i in range(time.shape[0]):
        for channel in range(CHANNELS):
            derivatives = _trajectory_channel(numbers, 0, channel, time[i])
            for order in range(ORDERS):
                out[i, order, channel] = derivatives[order]


class _Packed:
    """Mixin for trajectories with the property `packed`."""

    packed: Any

    def derivatives(self, time: Any) -> Floats:
        """Return the derivatives of order 0 to 6 of all channels at `time` (s), shape (*time.shape, 7, 4)."""
        times = np.asarray(time, np.float64)
        out = np.empty((times.size, ORDERS, CHANNELS))
        _evaluate(self.packed, times.ravel(), out)
        return out.reshape(*times.shape, ORDERS, CHANNELS)


@dataclass(frozen=True)
class Waypoints(_Packed):
    """A smooth trajectory through given points at given times, equation (1), from rest to rest.

    It is a minimum-snap spline whose derivatives of order 0 to 6 are continuous, see `minimum_snap`.

    Attributes:
        times: Times of the points, s; the first is 0.
        points: Points F_x, F_y, z (m) and optionally ψ (rad, default 0), see `references`.
        closed: Whether the trajectory repeats without stopping after the last time; the last point must then equal the
            first.

    Raises:
        TypeError: If a field has the wrong type.
        ValueError: If the times do not increase from 0, the points do not fit the times, or a number is not finite or
            its absolute value is larger than 1000.
    """

    times: Annotated[tuple[float, ...], Range(0.0, LARGEST, "s")]
    points: Annotated[tuple[tuple[float, ...], ...], Range(-LARGEST, LARGEST, "m and rad")]
    closed: bool = False
    kind: str = field(default="waypoints", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        times = _check_times(self.times)
        points = _check_points(self.points, len(times))
        if not isinstance(self.closed, bool):
            raise TypeError(f"closed must be true or false, not {self.closed!r}")
        if self.closed and points[0] != points[-1]:
            raise ValueError(f"the last point of closed waypoints must equal the first, {points[0]}, not {points[-1]}")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "points", points)

    @cached_property
    def packed(self) -> Floats:
        """The packed trajectory, shape (k,)."""
        times, points = np.array(self.times), np.array(self.points)
        origins, coefficients = times[:-1], minimum_snap(times, points, self.closed)
        if not self.closed:  # a piece at rest before the first time, and one after the last time
            rest = np.zeros((2, CHANNELS, COEFFICIENTS))
            rest[:, :, 0] = points[0], points[-1]
            origins = np.concatenate([times[:1], times])
            coefficients = np.concatenate([rest[:1], coefficients, rest[1:]])
        header = [times[-1] if self.closed else 0.0, len(origins), 0.0]
        return np.concatenate([header, origins, coefficients.ravel()])

    def sample_times(self) -> Floats:
        """Return times that resolve the whole trajectory, s, shape (k,)."""
        pairs = zip(self.times, self.times[1:], strict=False)
        return np.concatenate([np.linspace(a, b, max(41, int((b - a) / 0.02))) for a, b in pairs])


@dataclass(frozen=True)
class SinusoidTerm:
    """One term of `Sinusoids`, with one number for each channel or one for all.

    Raises:
        TypeError: If a field is neither a number nor four numbers.
        ValueError: If a number is not finite, or its absolute value is larger than 1000.
    """

    amplitude: Annotated[tuple[float, ...], Range(-LARGEST, LARGEST, "m and rad")] = (0.0, 0.0, 0.0, 0.0)
    frequency: Annotated[tuple[float, ...], Range(-LARGEST, LARGEST, "rad/s")] = (0.0, 0.0, 0.0, 0.0)
    phase: Annotated[tuple[float, ...], Range(-LARGEST, LARGEST, "rad")] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _check_channels(self, [item.name for item in fields(self)])


@dataclass(frozen=True)
class Sinusoids(_Packed):
    """A constant velocity plus any sum of sinusoids, equation (2).

    Attributes:
        offset: F_x, F_y, z (m) and ψ (rad) at time zero, without the terms.
        rate: Constant velocity of each channel, m/s and rad/s.
        terms: Terms, or mappings of their fields.

    Raises:
        TypeError: If a field has the wrong type.
        ValueError: If a number is not finite, or its absolute value is larger than 1000.
    """

    offset: Annotated[tuple[float, ...], Range(-LARGEST, LARGEST, "m and rad")] = (0.0, 0.0, 2.0, 0.0)
    rate: Annotated[tuple[float, ...], Range(-LARGEST, LARGEST, "m/s and rad/s")] = (0.0, 0.0, 0.0, 0.0)
    terms: tuple[SinusoidTerm, ...] = ()
    kind: str = field(default="sinusoids", init=False)

    def __post_init__(self) -> None:
        _check_channels(self, ["offset", "rate"])
        if not isinstance(self.terms, list | tuple) or not 1 <= len(self.terms) <= MOST_TERMS:
            raise ValueError(f"terms must be 1 to {MOST_TERMS} sinusoids, not {self.terms!r}")
        terms = tuple(from_plain(SinusoidTerm, item, f"terms[{i}]") for i, item in enumerate(self.terms))
        object.__setattr__(self, "terms", terms)

    @cached_property
    def packed(self) -> Floats:
        """The packed trajectory, shape (k,)."""
        zero = (0.0,) * CHANNELS
        places = [(self.offset, self.rate), *[(zero, zero)] * (len(self.terms) - 1)]
        columns = [
            Reference(*place, item.amplitude, item.frequency, item.phase).as_array()
            for place, item in zip(places, self.terms, strict=True)
        ]
        return np.concatenate([[0.0, 0.0, len(columns)], *columns])

    def sample_times(self) -> Floats:
        """Return times that resolve the slowest and the fastest term, over 10 s to 100 s, s, shape (k,)."""
        frequencies = np.abs([item.frequency for item in self.terms])
        moving = frequencies[frequencies > 0.0]
        slowest, fastest = (moving.min(), moving.max()) if moving.size else (1.0, 1.0)
        horizon = np.clip(2.0 * np.pi / slowest, 10.0, 100.0)
        return np.linspace(0.0, horizon, int(np.clip(horizon * max(50.0, 7.0 * fastest), 1, 20_000)))


Trajectory = Reference | Waypoints | Sinusoids
KINDS: dict[str, type[Any]] = {"waypoints": Waypoints, "sinusoids": Sinusoids}


def as_trajectory(value: Any, name: str) -> Trajectory:
    """Convert `value` to a trajectory.

    Args:
        value: `Reference`, `Waypoints`, `Sinusoids`, or a mapping of the fields of one of them: with ``kind``
            "waypoints" or "sinusoids", or without a kind the fields of `Reference`.
        name: Name of the value in error messages.

    Raises:
        TypeError: If `value` is none of these, or a field has the wrong type.
        ValueError: If a kind or field is unknown, or a value is out of range.
    """
    if isinstance(value, Waypoints | Sinusoids):
        return value
    if isinstance(value, Mapping) and "kind" in value:
        data = dict(value)
        kind = data.pop("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            raise ValueError(f"{name} has no kind {kind!r}{suggest(kind, KINDS)}; the kinds are {', '.join(KINDS)}")
        return cast(Trajectory, from_plain(KINDS[kind], data, name))
    return from_plain(Reference, value, name)


def _check_channels(instance: Any, names: Sequence[str]) -> None:
    """Replace fields with one number for each channel by tuples of floats after checking them."""
    for name in names:
        object.__setattr__(instance, name, as_vector(getattr(instance, name), CHANNELS, name))
    check_fields(instance)


def _check_times(times: Any) -> tuple[float, ...]:
    if not isinstance(times, tuple) or not 2 <= len(times) <= MOST_POINTS:
        raise ValueError(f"times must be 2 to {MOST_POINTS} numbers, not {times!r}")
    checked = tuple(check_number(time, f"times[{i}]", 0.0, LARGEST) for i, time in enumerate(times))
    if checked[0] != 0.0:
        raise ValueError(f"times must begin with 0, not {checked[0]:g}")
    intervals = np.diff(checked)
    if (shortest := intervals.min()) < SHORTEST_INTERVAL * (1.0 - 1e-9):
        late = checked[int(intervals.argmin()) + 1]
        raise ValueError(f"times must increase by at least {SHORTEST_INTERVAL:g} s, not by {shortest:g} s at {late:g}")
    if intervals.max() > LARGEST_RATIO * shortest:
        raise ValueError(
            f"the longest interval between times must be at most {LARGEST_RATIO:g} times the shortest, not"
            f" {intervals.max():g} s and {shortest:g} s"
        )
    return checked


def _check_points(points: Any, count: int) -> tuple[tuple[float, ...], ...]:
    if not isinstance(points, tuple) or len(points) != count:
        found = f"{len(points)} points" if isinstance(points, tuple) else repr(points)
        raise ValueError(f"points must be {count} points, as many as the times, not {found}")
    checked = []
    for i, point in enumerate(points):
        if not isinstance(point, tuple) or len(point) not in (CHANNELS - 1, CHANNELS):
            raise TypeError(f"points[{i}] must be three or four numbers (x, y, z and yaw), not {point!r}")
        numbers = [check_number(x, f"points[{i}]", -LARGEST, LARGEST) for x in point]
        checked.append((*numbers, 0.0) if len(numbers) < CHANNELS else tuple(numbers))
    return tuple(checked)
