"""Sinusoidal references with exact derivatives, and random ones.

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

from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import unpacker
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import REFERENCE_STREAM, Keys, derive, uniform, uniform_between
from quadpend_gym.physics.vectors import Vec3, load, store

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
# value of a channel and its time derivatives of order 1 to 6
Derivatives = tuple[float, float, float, float, float, float, float]


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
    value = offset + rate * time + amplitude * sine
    return value, rate + a1 * cosine, -a2 * sine, -a3 * cosine, a4 * sine, a5 * cosine, -a6 * sine


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


POINT_SIZE = 24
POINT_CHANNELS = [0, 1, 2, 21]  # fields of the values of the channels in a buffer of points


@inlined
def load_point(lanes: Any, lane: int) -> ReferencePoint:
    """Return the point in column `lane` of a (24, n) buffer."""
    return ReferencePoint(
        load(lanes, 0, lane),
        load(lanes, 3, lane),
        load(lanes, 6, lane),
        load(lanes, 9, lane),
        load(lanes, 12, lane),
        load(lanes, 15, lane),
        load(lanes, 18, lane),
        lanes[21, lane],
        lanes[22, lane],
        lanes[23, lane],
    )


@inlined
def store_point(point: ReferencePoint, lane: int, lanes: Any) -> None:
    """Write a point into column `lane` of a (24, n) buffer."""
    store(lanes, 0, lane, point.d0)
    store(lanes, 3, lane, point.d1)
    store(lanes, 6, lane, point.d2)
    store(lanes, 9, lane, point.d3)
    store(lanes, 12, lane, point.d4)
    store(lanes, 15, lane, point.d5)
    store(lanes, 18, lane, point.d6)
    store(lanes, 21, lane, Vec3(point.yaw, point.yaw_rate, point.yaw_acceleration))


@settings
class ReferenceSettings:
    """Relative frequency of each family of random references, and the bounds of their numbers."""

    hover: Annotated[float, Range(0.0, 1e6)] = 1.0  # relative frequency of constant references
    circle: Annotated[float, Range(0.0, 1e6)] = 1.0  # relative frequency of circles
    figure_eight: Annotated[float, Range(0.0, 1e6)] = 1.0  # relative frequency of figure eights
    helix: Annotated[float, Range(0.0, 1e6)] = 1.0  # relative frequency of helices
    # height above the ground z = 0, of a helix at the start
    height: Annotated[Interval, Range(0.0, 10_000.0, "m")] = (2.0, 3.0)
    # radius of circles and helices, half the length of figure eights, half the width of slaloms
    radius: Annotated[Interval, Range(1e-3, 1000.0, "m")] = (0.3, 1.5)
    acceleration: Annotated[Interval, Range(0.0, 1000.0, "m/s²")] = (0.2, 1.0)  # peak of the horizontal acceleration
    climb: Annotated[Interval, Range(-1000.0, 1000.0, "m/s")] = (-0.1, 0.1)  # vertical velocity of helices
    # largest absolute value of the constant part of the yaw
    yaw_offset: Annotated[float, Range(0.0, 1000.0, "rad")] = 0.5
    # largest amplitude of the sinusoidal part of the yaw
    yaw_amplitude: Annotated[float, Range(0.0, 1000.0, "rad")] = 0.3
    # largest angular frequency of the sinusoidal part of the yaw
    yaw_frequency: Annotated[float, Range(0.0, 10_000.0, "rad/s")] = 1.0
    slalom: Annotated[float, Range(0.0, 1e6)] = 0.0  # relative frequency of slaloms
    speed: Annotated[Interval, Range(0.0, 1000.0, "m/s")] = (1.0, 3.0)  # forward velocity of slaloms

    def __post_init__(self) -> None:
        if not (self.hover or self.circle or self.figure_eight or self.helix or self.slalom):
            raise ValueError("one of hover, circle, figure_eight, helix and slalom must be above zero")


_unpack = unpacker(ReferenceSettings)


@inlined
def draw_reference(key: Any, ranges: ReferenceSettings, lanes: Any, lane: int) -> None:
    """Draw a random reference into column `lane` of a (20, n) buffer.

    The family is drawn first, then the radius and the peak horizontal acceleration a, which determine the frequency:
    ω² = a / radius for a circle and ω² = 8 a / (17 radius) for a figure eight, since the figure eight has
    |F̈| = radius ω² √(s + 16 s (1−s)) with s = sin²(ωt + phase). A slalom moves along ±x with a constant velocity and
    along y as a circle does, so its peak acceleration is that of a circle.
    """
    other_families = ranges.hover + ranges.circle + ranges.figure_eight + ranges.helix
    choice = uniform(key, 0) * (other_families + ranges.slalom)
    is_hover = choice < ranges.hover
    helix_from = ranges.hover + ranges.circle + ranges.figure_eight
    is_figure_eight = select(choice >= ranges.hover + ranges.circle, select(choice < helix_from, 1.0, 0.0), 0.0) > 0.5
    is_slalom = select(choice >= other_families, select(ranges.slalom > 0.0, 1.0, 0.0), 0.0) > 0.5
    is_helix = select(choice >= helix_from, select(is_slalom, 0.0, 1.0), 0.0) > 0.5
    radius = select(is_hover, 0.0, uniform_between(key, 1, ranges.radius[0], ranges.radius[1]))
    acceleration = uniform_between(key, 2, ranges.acceleration[0], ranges.acceleration[1])
    divisor = select(is_figure_eight, 2.0, 1.0)
    peak = select(is_figure_eight, 17.0 / 8.0, 1.0)  # largest |F̈| / (radius ω²)
    frequency = select(is_hover, 0.0, np.sqrt(acceleration / (peak * radius)))
    phase = uniform_between(key, 3, 0.0, 2.0 * np.pi)
    sign = select(uniform(key, 4) < 0.5, 1.0, -1.0)
    climb = uniform_between(key, 7, ranges.climb[0], ranges.climb[1])
    speed = uniform_between(key, 11, ranges.speed[0], ranges.speed[1])
    for field in range(REFERENCE_SIZE):
        lanes[field, lane] = 0.0
    lanes[_OFFSET + _Z, lane] = uniform_between(key, 5, ranges.height[0], ranges.height[1])
    lanes[_OFFSET + _YAW, lane] = uniform_between(key, 6, -ranges.yaw_offset, ranges.yaw_offset)
    lanes[_RATE + _Z, lane] = select(is_helix, climb, 0.0)
    lanes[_RATE + _X, lane] = select(is_slalom, sign * speed, 0.0)
    lanes[_AMPLITUDE + _X, lane] = select(is_slalom, 0.0, radius)
    lanes[_AMPLITUDE + _Y, lane] = sign * radius / divisor
    lanes[_AMPLITUDE + _YAW, lane] = uniform_between(key, 8, 0.0, ranges.yaw_amplitude)
    lanes[_FREQUENCY + _X, lane] = select(is_slalom, 0.0, frequency)
    lanes[_FREQUENCY + _Y, lane] = divisor * frequency
    lanes[_FREQUENCY + _YAW, lane] = uniform_between(key, 9, 0.0, ranges.yaw_frequency)
    lanes[_PHASE + _X, lane] = select(is_figure_eight, phase, phase + 0.5 * np.pi)
    lanes[_PHASE + _Y, lane] = divisor * phase
    lanes[_PHASE + _YAW, lane] = uniform_between(key, 10, 0.0, 2.0 * np.pi)


@compiled
def draw_references(rows: Integers, seeds: Keys, episodes: Integers, ranges: Floats, reference: Floats) -> None:
    """Draw random references for the sub-environments `rows` into an array of all, shape (n, 20).

    Seeds (keys of random streams) and numbers of episodes are those of all; `ranges` is a packed `ReferenceSettings`.
    """
    bounds = _unpack(ranges)
    for row in rows:
        key = derive(derive(seeds[row], episodes[row]), REFERENCE_STREAM)
        draw_reference(key, bounds, reference.T, row)
