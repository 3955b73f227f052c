"""Three-vectors inside kernels: named tuples that compile away, and the few operations on them."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.jit import inlined


class Vec3(NamedTuple):
    """A vector (x, y, z)."""

    x: float
    y: float
    z: float


@inlined
def add(a: Vec3, b: Vec3) -> Vec3:
    """a + b."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@inlined
def scale(factor: float, a: Vec3) -> Vec3:
    """factor · a."""
    return Vec3(factor * a.x, factor * a.y, factor * a.z)


@inlined
def axpy(factor: float, a: Vec3, b: Vec3) -> Vec3:
    """factor · a + b."""
    return Vec3(factor * a.x + b.x, factor * a.y + b.y, factor * a.z + b.z)


@inlined
def dot(a: Vec3, b: Vec3) -> float:
    """a · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@inlined
def norm(a: Vec3) -> float:
    """|a|."""
    return float(np.sqrt(dot(a, a)))


@inlined
def load(lanes: Any, first: int, lane: int) -> Vec3:
    """The vector stored in three consecutive fields of a (field, lane) buffer."""
    return Vec3(lanes[first, lane], lanes[first + 1, lane], lanes[first + 2, lane])


@inlined
def store(lanes: Any, first: int, lane: int, a: Vec3) -> None:
    """Write a vector into three consecutive fields of a (field, lane) buffer."""
    lanes[first, lane] = a.x
    lanes[first + 1, lane] = a.y
    lanes[first + 2, lane] = a.z
