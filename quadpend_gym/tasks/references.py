"""Reference trajectories with exact derivatives.

A reference gives the flat outputs over time: F_x = x + l r_x and F_y = y + l r_y (the bob's horizontal position), the
quadrotor's height z, all in the world frame, and the yaw angle ψ. Each of these four channels is

    (1)  offset + rate · t + amplitude · sin(frequency · t + phase)

which holds hovering, circles, figure eights (Gerono's lemniscate) and helices, and any Lissajous figure besides.

| channel | symbol | unit |
|---------|--------|------|
| 0       | F_x    | m    |
| 1       | F_y    | m    |
| 2       | z      | m    |
| 3       | ψ      | rad  |
"""

from dataclasses import astuple, dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.streams import REFERENCE_STREAM, Keys, derive, uniform, uniform_between
from quadpend_gym.core.validation import as_vector, check_number
from quadpend_gym.physics.vectors import Vec3

CHANNELS = 4
REFERENCE_SIZE = 5 * CHANNELS
LARGEST = 1000.0  # of any number of a reference, in SI units
ORDERS = 7  # derivatives of order 0 to 6


class Derivatives(NamedTuple):
    """A channel and its time derivatives of order 1 to 6."""

    d0: float
    d1: float
    d2: float
    d3: float
    d4: float
    d5: float
    d6: float


@inlined
def channel_derivatives(lanes: Any, channel: int, lane: int, time: float) -> Derivatives:
    """Equation (1) and its derivatives at `time` (s), from column `lane` of a (20, n) buffer."""
    offset, rate = lanes[channel, lane], lanes[4 + channel, lane]
    amplitude, frequency, phase = lanes[8 + channel, lane], lanes[12 + channel, lane], lanes[16 + channel, lane]
    sine, cosine = sincos(frequency * time + phase)
    a1 = amplitude * frequency
    a2 = a1 * frequency
    a3 = a2 * frequency
    a4 = a3 * frequency
    a5 = a4 * frequency
    a6 = a5 * frequency
    return Derivatives(
        offset + rate * time + amplitude * sine,
        rate + a1 * cosine,
        -a2 * sine,
        -a3 * cosine,
        a4 * sine,
        a5 * cosine,
        -a6 * sine,
    )


class ReferencePoint(NamedTuple):
    """A reference at one instant: derivatives of order 0 to 6 of (F_x, F_y, z), and of order 0 to 2 of ψ."""

    d0: Vec3
    d1: Vec3
    d2: Vec3
    d3: Vec3
    d4: Vec3
    d5: Vec3
    d6: Vec3
    yaw: float
    yaw_rate: float
    yaw_acceleration: float


@inlined
def reference_point(lanes: Any, lane: int, time: float) -> ReferencePoint:
    """The reference in column `lane` of a (20, n) buffer at `time` (s)."""
    x = channel_derivatives(lanes, 0, lane, time)
    y = channel_derivatives(lanes, 1, lane, time)
    z = channel_derivatives(lanes, 2, lane, time)
    yaw = channel_derivatives(lanes, 3, lane, time)
    return ReferencePoint(
        Vec3(x.d0, y.d0, z.d0),
        Vec3(x.d1, y.d1, z.d1),
        Vec3(x.d2, y.d2, z.d2),
        Vec3(x.d3, y.d3, z.d3),
        Vec3(x.d4, y.d4, z.d4),
        Vec3(x.d5, y.d5, z.d5),
        Vec3(x.d6, y.d6, z.d6),
        yaw.d0,
        yaw.d1,
        yaw.d2,
    )


@compiled
def _evaluate(lanes: Floats, time: Floats, out: Floats) -> None:
    for i in range(time.shape[0]):
        for channel in range(CHANNELS):
            derivatives = channel_derivatives(lanes, channel, 0, time[i])
            for order in range(ORDERS):
                out[i, order, channel] = derivatives[order]


@dataclass(frozen=True)
class Reference:
    """One reference trajectory; every field has one number for each of F_x (m), F_y (m), z (m) and ψ (rad).

    Raises:
        TypeError: a field is not a number or four numbers.
        ValueError: a number is not finite, or larger than 1000 in size.
    """

    offset: tuple[float, ...] = (0.0, 0.0, 2.0, 0.0)
    rate: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    amplitude: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    frequency: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    phase: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for field in fields(self):
            values = as_vector(getattr(self, field.name), CHANNELS, field.name)
            object.__setattr__(self, field.name, tuple(check_number(x, field.name, -LARGEST, LARGEST) for x in values))

    @classmethod
    def hover(cls, x: float = 0.0, y: float = 0.0, z: float = 2.0, yaw: float = 0.0) -> "Reference":
        """Stand still at a point (m) with a yaw angle (rad)."""
        return cls(offset=(x, y, z, yaw))

    @classmethod
    def circle(cls, radius: float, frequency: float, height: float = 2.0, climb: float = 0.0) -> "Reference":
        """A horizontal circle (m, rad/s; negative: clockwise) around the z axis, or a helix with `climb` in m/s."""
        return cls(
            offset=(0.0, 0.0, height, 0.0),
            rate=(0.0, 0.0, climb, 0.0),
            amplitude=(radius, radius, 0.0, 0.0),
            frequency=(frequency, frequency, 0.0, 0.0),
            phase=(np.pi / 2, 0.0, 0.0, 0.0),
        )

    @classmethod
    def figure_eight(cls, radius: float, frequency: float, height: float = 2.0) -> "Reference":
        """A horizontal figure eight of half-length `radius` (m), passed once in 2π/`frequency` (rad/s)."""
        return cls(
            offset=(0.0, 0.0, height, 0.0),
            amplitude=(radius, radius / 2, 0.0, 0.0),
            frequency=(frequency, 2 * frequency, 0.0, 0.0),
        )

    @classmethod
    def from_array(cls, array: Floats) -> "Reference":
        """The inverse of `as_array`, without its checks: a task may draw larger numbers."""
        reference = object.__new__(cls)
        for field, values in zip(fields(cls), array.reshape(-1, CHANNELS).tolist(), strict=True):
            object.__setattr__(reference, field.name, tuple(values))
        return reference

    def as_array(self) -> Floats:
        """The fields in order, shape (20,): the kernel's view."""
        return np.array(astuple(self)).ravel()

    def derivatives(self, time: float | Floats) -> Floats:
        """The four channels at `time` (s) and their derivatives of order 0 to 6, shape (..., 7, 4)."""
        times = np.asarray(time, np.float64)
        out = np.empty((times.size, ORDERS, CHANNELS))
        _evaluate(self.as_array()[:, np.newaxis], times.ravel(), out)
        return out.reshape(*times.shape, ORDERS, CHANNELS)


class ReferenceRanges(NamedTuple):
    """`tasks.ReferenceSettings` inside a kernel."""

    hover: float
    circle: float
    figure_eight: float
    helix: float
    height_low: float
    height_high: float
    radius_low: float
    radius_high: float
    acceleration_low: float
    acceleration_high: float
    climb_low: float
    climb_high: float
    yaw_offset: float
    yaw_amplitude: float
    yaw_frequency: float


@inlined
def draw_reference(key: Any, ranges: ReferenceRanges, lanes: Any, lane: int) -> None:
    """Draw a random reference into column `lane` of a (20, n) buffer.

    The family is drawn first, then its size and peak horizontal acceleration a, which fixes the frequency:
    ω² = a / radius for a circle and ω² = 8 a / (17 radius) for a figure eight, where |F̈| = radius ω² √(s + 16 s (1−s))
    with s = sin²(ωt + phase).
    """
    choice = uniform(key, 0) * (ranges.hover + ranges.circle + ranges.figure_eight + ranges.helix)
    hovers = choice < ranges.hover
    eight = (choice >= ranges.hover + ranges.circle) & (choice < ranges.hover + ranges.circle + ranges.figure_eight)
    helix = choice >= ranges.hover + ranges.circle + ranges.figure_eight
    radius = 0.0 if hovers else uniform_between(key, 1, ranges.radius_low, ranges.radius_high)
    acceleration = uniform_between(key, 2, ranges.acceleration_low, ranges.acceleration_high)
    divisor = 2.0 if eight else 1.0
    peak = 17.0 / 8.0 if eight else 1.0  # of |F̈|, in units of radius · frequency²
    frequency = 0.0 if hovers else np.sqrt(acceleration / (peak * radius))
    phase = uniform_between(key, 3, 0.0, 2.0 * np.pi)
    turn = 1.0 if uniform(key, 4) < 0.5 else -1.0
    for field in range(REFERENCE_SIZE):
        lanes[field, lane] = 0.0
    lanes[2, lane] = uniform_between(key, 5, ranges.height_low, ranges.height_high)
    lanes[3, lane] = uniform_between(key, 6, -ranges.yaw_offset, ranges.yaw_offset)
    lanes[6, lane] = uniform_between(key, 7, ranges.climb_low, ranges.climb_high) if helix else 0.0
    lanes[8, lane] = radius
    lanes[9, lane] = turn * radius / divisor
    lanes[11, lane] = uniform_between(key, 8, 0.0, ranges.yaw_amplitude)
    lanes[12, lane] = frequency
    lanes[13, lane] = divisor * frequency
    lanes[15, lane] = uniform_between(key, 9, 0.0, ranges.yaw_frequency)
    lanes[16, lane] = phase if eight else phase + 0.5 * np.pi
    lanes[17, lane] = divisor * phase
    lanes[19, lane] = uniform_between(key, 10, 0.0, 2.0 * np.pi)


@compiled
def draw_references(rows: Integers, seeds: Keys, episodes: Integers, ranges: Floats, reference: Floats) -> None:
    """Draw a random reference for each of the given rows.

    Args:
        rows: indices into `reference`, shape (m,).
        seeds: root of each row's random streams, shape (n,).
        episodes: number of each row's episode, shape (n,).
        ranges: `tasks.flatten` of the task's references.
        reference: written, shape (n, 20).
    """
    r = ranges
    bounds = ReferenceRanges(
        r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], r[12], r[13], r[14]
    )
    for row in rows:
        key = derive(derive(seeds[row], episodes[row]), REFERENCE_STREAM)
        draw_reference(key, bounds, reference.T, row)
