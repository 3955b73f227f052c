"""Vectors of three or four numbers and matrices inside compiled functions, and operations on them.

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
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Return a × b."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inlined
def centripetal(rate: Vec3, arm: Vec3) -> Vec3:
    """Return ω × (ω × p)."""
    return add(scale(dot(rate, arm), rate), scale(-dot(rate, rate), arm))


class Symmetric(NamedTuple):
    """A symmetric 3 × 3 matrix."""

    xx: float
    yy: float
    zz: float
    xy: float
    xz: float
    yz: float


@inlined
def apply(matrix: Symmetric, v: Vec3) -> Vec3:
    """Return the product of a symmetric matrix and a vector."""
    return Vec3(
        matrix.xx * v.x + matrix.xy * v.y + matrix.xz * v.z,
        matrix.xy * v.x + matrix.yy * v.y + matrix.yz * v.z,
        matrix.xz * v.x + matrix.yz * v.y + matrix.zz * v.z,
    )


@inlined
def inverse(a: Symmetric) -> Symmetric:
    """Return the inverse of a symmetric matrix."""
    xx = a.yy * a.zz - a.yz * a.yz
    xy = a.xz * a.yz - a.xy * a.zz
    xz = a.xy * a.yz - a.xz * a.yy
    per_determinant = 1.0 / (a.xx * xx + a.xy * xy + a.xz * xz)
    return Symmetric(
        per_determinant * xx,
        per_determinant * (a.xx * a.zz - a.xz * a.xz),
        per_determinant * (a.xx * a.yy - a.xy * a.xy),
        per_determinant * xy,
        per_determinant * xz,
        per_determinant * (a.xy * a.xz - a.xx * a.yz),
    )


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


@inlined
def load_symmetric(lanes: Any, first: int, lane: int) -> Symmetric:
    """Return the matrix in the six fields from `first` in column `lane` of a (field, lane) buffer."""
    diagonal, products = load(lanes, first, lane), load(lanes, first + 3, lane)
    return Symmetric(diagonal.x, diagonal.y, diagonal.z, products.x, products.y, products.z)


@inlined
def store_symmetric(lanes: Any, first: int, lane: int, a: Symmetric) -> None:
    """Write a symmetric matrix into the six fields from `first` in column `lane` of a (field, lane) buffer."""
    store(lanes, first, lane, Vec3(a.xx, a.yy, a.zz))
    store(lanes, first + 3, lane, Vec3(a.xy, a.xz, a.yz))


class Four(NamedTuple):
    """One number for each rotor; or thrust (N) and torques (N·m)."""

    a: float
    b: float
    c: float
    d: float


class Matrix4(NamedTuple):
    """A 4 × 4 matrix as its rows."""

    a: Four
    b: Four
    c: Four
    d: Four


@inlined
def _dot4(a: Four, b: Four) -> float:
    return a.a * b.a + a.b * b.b + a.c * b.c + a.d * b.d


@inlined
def multiply(matrix: Matrix4, v: Four) -> Four:
    """Return the product of a 4 × 4 matrix and a vector."""
    return Four(_dot4(matrix.a, v), _dot4(matrix.b, v), _dot4(matrix.c, v), _dot4(matrix.d, v))


@inlined
def times(factor: float, v: Four) -> Four:
    """Return factor · v."""
    return Four(factor * v.a, factor * v.b, factor * v.c, factor * v.d)


@inlined
def axpy4(factor: float, x: Four, y: Four) -> Four:
    """Return y + factor · x."""
    return Four(y.a + factor * x.a, y.b + factor * x.b, y.c + factor * x.c, y.d + factor * x.d)


@inlined
def minus4(a: Four, b: Four) -> Four:
    """Return a − b."""
    return Four(a.a - b.a, a.b - b.b, a.c - b.c, a.d - b.d)


@inlined
def load_four(lanes: Any, first: int, lane: int) -> Four:
    """Return the four numbers from row `first` in column `lane`."""
    return Four(lanes[first, lane], lanes[first + 1, lane], lanes[first + 2, lane], lanes[first + 3, lane])


@inlined
def store_four(lanes: Any, first: int, lane: int, v: Any) -> None:
    """Write four numbers into the rows from `first` in column `lane`."""
    lanes[first, lane] = v[0]
    lanes[first + 1, lane] = v[1]
    lanes[first + 2, lane] = v[2]
    lanes[first + 3, lane] = v[3]
