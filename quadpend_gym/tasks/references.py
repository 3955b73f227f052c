"""Reference trajectories with exact derivatives.

A reference gives the flat outputs as functions of time: the horizontal position of the bob, F_x = x + l r_x and
F_y = y + l r_y, the height z of the quadrotor, and the yaw angle ψ. Positions are in the world frame. Each of these
four channels is

    (1)  offset + rate · t + amplitude · sin(frequency · t + phase)

Hovering, circles, figure eights (Gerono's lemniscate), helices, slaloms and all Lissajous figures have this form.

| channel | symbol | unit |
|---------|--------|------|
| 0       | F_x    | m    |
| 1       | F_y    | m    |
| 2       | z      | m    |
| 3       | ψ      | rad  |
"""

from dataclasses import astuple, fields
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.core.streams import REFERENCE_STREAM, Keys, derive, uniform, uniform_between
from quadpend_gym.physics.vectors import Vec3

CHANNELS = 4
REFERENCE_SIZE = 5 * CHANNELS
LARGEST = 1000.0  # largest absolute value of a number of a reference, SI units
ORDERS = 7  # derivatives of order 0 to 6
# Layout of a reference array: for each coefficient of (1) one number for each channel.
_OFFSET, _RATE, _AMPLITUDE, _FREQUENCY, _PHASE = 0, CHANNELS, 2 * CHANNELS, 3 * CHANNELS, 4 * CHANNELS
_X, _Y, _Z, _YAW = 0, 1, 2, 3


def _for_each(value: Any) -> Any:
    return (value,) * CHANNELS if isinstance(value, int | float) else value


Channels = Annotated[tuple[float, float, float, float], BeforeValidator(_for_each)]  # one number is one for each


class Derivatives(NamedTuple):
    """Value of a channel and its time derivatives of order 1 to 6."""

    d0: float
    d1: float
    d2: float
    d3: float
    d4: float
    d5: float
    d6: float


@inlined
def channel_derivatives(lanes: Any, channel: int, lane: int, time: float) -> Derivatives:
    """Return equation (1) and its derivatives at `time` (s) for the reference in column `lane` of a (20, n) buffer."""
    offset, rate = lanes[_OFFSET + channel, lane], lanes[_RATE + channel, lane]
    amplitude, frequency = lanes[_AMPLITUDE + channel, lane], lanes[_FREQUENCY + channel, lane]
    phase = lanes[_PHASE + channel, lane]
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
    """Reference at one time: derivatives of order 0 to 6 of (F_x, F_y, z), and of order 0 to 2 of ψ."""

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
def channels_to_point(x: Derivatives, y: Derivatives, z: Derivatives, yaw: Derivatives) -> ReferencePoint:
    """Return the point of a reference with these channels."""
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


@inlined
def reference_point(lanes: Any, lane: int, time: float) -> ReferencePoint:
    """Return the reference in column `lane` of a (20, n) buffer at `time` (s)."""
    return channels_to_point(
        channel_derivatives(lanes, _X, lane, time),
        channel_derivatives(lanes, _Y, lane, time),
        channel_derivatives(lanes, _Z, lane, time),
        channel_derivatives(lanes, _YAW, lane, time),
    )


@compiled
def _evaluate(lanes: Floats, time: Floats, out: Floats) -> None:
    for i in range(time.shape[0]):
        for channel in range(CHANNELS):
            derivatives = channel_derivatives(lanes, channel, 0, time[i])
            for order in range(ORDERS):
                out[i, order, channel] = derivatives[order]


@settings
class Reference:
    """One reference trajectory, equation (1).

    Every field has one number for each channel: F_x (m), F_y (m), z (m) and ψ (rad).
    """

    offset: Annotated[Channels, Range(-LARGEST, LARGEST, "m and rad")] = (0.0, 0.0, 2.0, 0.0)
    rate: Annotated[Channels, Range(-LARGEST, LARGEST, "m/s and rad/s")] = (0.0, 0.0, 0.0, 0.0)
    amplitude: Annotated[Channels, Range(-LARGEST, LARGEST, "m and rad")] = (0.0, 0.0, 0.0, 0.0)
    frequency: Annotated[Channels, Range(-LARGEST, LARGEST, "rad/s")] = (0.0, 0.0, 0.0, 0.0)
    phase: Annotated[Channels, Range(-LARGEST, LARGEST, "rad")] = (0.0, 0.0, 0.0, 0.0)

    @classmethod
    def hover(cls, x: float = 0.0, y: float = 0.0, z: float = 2.0, yaw: float = 0.0) -> "Reference":
        """Return a constant reference: a point (m) and a yaw angle (rad)."""
        return cls(offset=(x, y, z, yaw))

    @classmethod
    def circle(cls, radius: float, frequency: float, height: float = 2.0, climb: float = 0.0) -> "Reference":
        """Return a horizontal circle around the z axis, or a helix.

        Args:
            radius: Radius, m.
            frequency: Angular frequency, rad/s; negative for clockwise motion seen from above.
            height: Height at time zero, m.
            climb: Vertical velocity, m/s; zero for a circle.
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
        """Return a horizontal figure eight.

        Args:
            radius: Half of its length, m.
            frequency: Angular frequency, rad/s; the period is 2π/`frequency`.
            height: Height, m.
        """
        return cls(
            offset=(0.0, 0.0, height, 0.0),
            amplitude=(radius, radius / 2, 0.0, 0.0),
            frequency=(frequency, 2 * frequency, 0.0, 0.0),
        )

    @classmethod
    def from_array(cls, array: Floats) -> "Reference":
        """Return the reference of an array from `as_array`, without checks, since a task may draw larger numbers."""
        reference = object.__new__(cls)
        for field, values in zip(fields(cls), array.reshape(-1, CHANNELS).tolist(), strict=True):
            object.__setattr__(reference, field.name, tuple(values))
        return reference

    def as_array(self) -> Floats:
        """Return the fields in order as an array of shape (20,)."""
        return np.array(astuple(self)).ravel()

    def derivatives(self, time: float | Floats) -> Floats:
        """Return the four channels at `time` (s) and their derivatives of order 0 to 6, shape (..., 7, 4)."""
        times = np.asarray(time, np.float64)
        out = np.empty((times.size, ORDERS, CHANNELS))
        _evaluate(self.as_array()[:, np.newaxis], times.ravel(), out)
        return out.reshape(*times.shape, ORDERS, CHANNELS)


class ReferenceRanges(NamedTuple):
    """The values of `ReferenceSettings` inside compiled functions."""

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
    slalom: float
    speed_low: float
    speed_high: float


@inlined
def draw_reference(key: Any, ranges: ReferenceRanges, lanes: Any, lane: int) -> None:
    """Draw a random reference into column `lane` of a (20, n) buffer.

    The family is drawn first, then the radius and the peak horizontal acceleration a, which determine the frequency:
    ω² = a / radius for a circle and ω² = 8 a / (17 radius) for a figure eight, since the figure eight has
    |F̈| = radius ω² √(s + 16 s (1−s)) with s = sin²(ωt + phase). A slalom moves along ±x with a constant velocity and
    along y as a circle does, so its peak acceleration is that of a circle.
    """
    other_families = ranges.hover + ranges.circle + ranges.figure_eight + ranges.helix
    choice = uniform(key, 0) * (other_families + ranges.slalom)
    is_hover = choice < ranges.hover
    is_figure_eight = (choice >= ranges.hover + ranges.circle) & (
        choice < ranges.hover + ranges.circle + ranges.figure_eight
    )
    is_slalom = (choice >= other_families) & (ranges.slalom > 0.0)
    is_helix = (choice >= ranges.hover + ranges.circle + ranges.figure_eight) & ~is_slalom
    radius = 0.0 if is_hover else uniform_between(key, 1, ranges.radius_low, ranges.radius_high)
    acceleration = uniform_between(key, 2, ranges.acceleration_low, ranges.acceleration_high)
    divisor = 2.0 if is_figure_eight else 1.0
    peak = 17.0 / 8.0 if is_figure_eight else 1.0  # largest |F̈| / (radius ω²)
    frequency = 0.0 if is_hover else np.sqrt(acceleration / (peak * radius))
    phase = uniform_between(key, 3, 0.0, 2.0 * np.pi)
    sign = 1.0 if uniform(key, 4) < 0.5 else -1.0
    for field in range(REFERENCE_SIZE):
        lanes[field, lane] = 0.0
    lanes[_OFFSET + _Z, lane] = uniform_between(key, 5, ranges.height_low, ranges.height_high)
    lanes[_OFFSET + _YAW, lane] = uniform_between(key, 6, -ranges.yaw_offset, ranges.yaw_offset)
    lanes[_RATE + _Z, lane] = uniform_between(key, 7, ranges.climb_low, ranges.climb_high) if is_helix else 0.0
    lanes[_RATE + _X, lane] = sign * uniform_between(key, 11, ranges.speed_low, ranges.speed_high) if is_slalom else 0.0
    lanes[_AMPLITUDE + _X, lane] = 0.0 if is_slalom else radius
    lanes[_AMPLITUDE + _Y, lane] = sign * radius / divisor
    lanes[_AMPLITUDE + _YAW, lane] = uniform_between(key, 8, 0.0, ranges.yaw_amplitude)
    lanes[_FREQUENCY + _X, lane] = 0.0 if is_slalom else frequency
    lanes[_FREQUENCY + _Y, lane] = divisor * frequency
    lanes[_FREQUENCY + _YAW, lane] = uniform_between(key, 9, 0.0, ranges.yaw_frequency)
    lanes[_PHASE + _X, lane] = phase if is_figure_eight else phase + 0.5 * np.pi
    lanes[_PHASE + _Y, lane] = divisor * phase
    lanes[_PHASE + _YAW, lane] = uniform_between(key, 10, 0.0, 2.0 * np.pi)


@compiled
def draw_references(rows: Integers, seeds: Keys, episodes: Integers, ranges: Floats, reference: Floats) -> None:
    """Draw a random reference for some of n sub-environments.

    Args:
        rows: Indices of the sub-environments, shape (m,).
        seeds: Key of the random stream of each sub-environment, shape (n,).
        episodes: Number of the episode of each sub-environment, shape (n,).
        ranges: Values of `ReferenceSettings`, see `quadpend_gym.tasks.flatten`, shape (18,).
        reference: References, shape (n, 20), see `Reference.as_array`, changed in place.
    """
    r = ranges
    bounds = ReferenceRanges(
        *(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8]),
        *(r[9], r[10], r[11], r[12], r[13], r[14], r[15], r[16], r[17]),
    )
    for row in rows:
        key = derive(derive(seeds[row], episodes[row]), REFERENCE_STREAM)
        draw_reference(key, bounds, reference.T, row)
