"""Vectors of three numbers inside compiled functions, and operations on them.

The compiler keeps the named tuples in registers, so they cost nothing at run time.
"""

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
    """Return a + b."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@inlined
def scale(factor: float, a: Vec3) -> Vec3:
    """Return factor · a."""
    return Vec3(factor * a.x, factor * a.y, factor * a.z)


@inlined
def axpy(factor: float, a: Vec3, b: Vec3) -> Vec3:
    """Return factor · a + b."""
    return Vec3(factor * a.x + b.x, factor * a.y + b.y, factor * a.z + b.z)


@inlined
def dot(a: Vec3, b: Vec3) -> float:
    """Return the dot product a · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@inlined
def norm(a: Vec3) -> float:
    """Return the Euclidean norm |a|."""
    return float(np.sqrt(dot(a, a)))


@inlined
def load(lanes: Any, first: int, lane: int) -> Vec3:
    """Return the vector in the three fields from `first` in column `lane` of a (field, lane) buffer."""
    return Vec3(lanes[first, lane], lanes[first + 1, lane], lanes[first + 2, lane])


@inlined
def store(lanes: Any, first: int, lane: int, a: Vec3) -> None:
    """Write a vector into the three fields from `first` in column `lane` of a (field, lane) buffer."""
    lanes[first, lane] = a.x
    lanes[first + 1, lane] = a.y
    lanes[first + 2, lane] = a.z
