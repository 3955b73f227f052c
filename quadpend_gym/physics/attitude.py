"""Attitude on SO(3) inside compiled functions: unit quaternions, rotation matrices, Euler angles and their rates.

A quaternion q = (w, x, y, z) and the rotation matrix R that it stands for map vectors of the body frame to the world
frame. With the roll φ, pitch θ and yaw ψ of `quadpend_gym.physics.state` and the body rate ω (body frame):

    (1)  R = Rz(ψ) Ry(θ) Rx(φ),                q = qz(ψ) qy(θ) qx(φ)
    (2)  q̇ = ½ q ∘ (0, ω)
    (3)  ω = (φ̇ − ψ̇ sθ,  θ̇ cφ + ψ̇ sφ cθ,  −θ̇ sφ + ψ̇ cφ cθ)
    (4)  ψ̇ = (ω_y sφ + ω_z cφ)/cθ,   θ̇ = ω_y cφ − ω_z sφ,   φ̇ = ω_x + ψ̇ sθ

Equation (4) is singular at θ = ±90°, where the Euler angles are not unique. There, this module bounds cos θ from below,
so the rates stay finite. Nothing is integrated in Euler angles: they are outputs.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.elementary import arctan2, sincos
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Vec3, axpy, dot, scale

_MIN_COS_PITCH = 1e-3  # lower bound of cos θ in equation (4)


class Quaternion(NamedTuple):
    """A quaternion w + x i + y j + z k."""

    w: float
    x: float
    y: float
    z: float


class Rotation(NamedTuple):
    """A rotation matrix R as its columns, which are the body axes in the world frame."""

    x: Vec3
    y: Vec3
    z: Vec3


@inlined
def to_world(rotation: Rotation, v: Vec3) -> Vec3:
    """Return R v, for v in the body frame."""
    return axpy(v.x, rotation.x, axpy(v.y, rotation.y, scale(v.z, rotation.z)))


@inlined
def to_body(rotation: Rotation, v: Vec3) -> Vec3:
    """Return Rᵀ v, for v in the world frame."""
    return Vec3(dot(rotation.x, v), dot(rotation.y, v), dot(rotation.z, v))


@inlined
def rotation_matrix(q: Quaternion) -> Rotation:
    """Return R of a unit quaternion; the product of R with q·q of another one.

    Within a Runge–Kutta step q·q is not quite 1. This form then still commutes with a rotation of the world.
    """
    ww, xx, yy, zz = q.w * q.w, q.x * q.x, q.y * q.y, q.z * q.z
    xy, xz, yz = q.x * q.y, q.x * q.z, q.y * q.z
    wx, wy, wz = q.w * q.x, q.w * q.y, q.w * q.z
    return Rotation(
        Vec3((ww + xx) - (yy + zz), 2.0 * (xy + wz), 2.0 * (xz - wy)),
        Vec3(2.0 * (xy - wz), (ww + yy) - (xx + zz), 2.0 * (yz + wx)),
        Vec3(2.0 * (xz + wy), 2.0 * (yz - wx), (ww + zz) - (xx + yy)),
    )


@inlined
def quaternion_rate(q: Quaternion, rate: Vec3) -> Quaternion:
    """Return q̇, equation (2)."""
    return Quaternion(
        -0.5 * (q.x * rate.x + q.y * rate.y + q.z * rate.z),
        0.5 * (q.w * rate.x + q.y * rate.z - q.z * rate.y),
        0.5 * (q.w * rate.y + q.z * rate.x - q.x * rate.z),
        0.5 * (q.w * rate.z + q.x * rate.y - q.y * rate.x),
    )


@inlined
def quaternion_axpy(factor: float, a: Quaternion, b: Quaternion) -> Quaternion:
    """Return factor · a + b."""
    return Quaternion(factor * a.w + b.w, factor * a.x + b.x, factor * a.y + b.y, factor * a.z + b.z)


@inlined
def normalised(q: Quaternion) -> Quaternion:
    """Return q divided by its norm."""
    per_norm = 1.0 / np.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    return Quaternion(per_norm * q.w, per_norm * q.x, per_norm * q.y, per_norm * q.z)


@inlined
def quaternion_from_euler(euler: Vec3) -> Quaternion:
    """Return q, equation (1)."""
    s1, c1 = sincos(0.5 * euler.x)
    s2, c2 = sincos(0.5 * euler.y)
    s3, c3 = sincos(0.5 * euler.z)
    return Quaternion(
        c3 * c2 * c1 + s3 * s2 * s1,
        c3 * c2 * s1 - s3 * s2 * c1,
        c3 * s2 * c1 + s3 * c2 * s1,
        s3 * c2 * c1 - c3 * s2 * s1,
    )


@inlined
def euler_from_rotation(rotation: Rotation, yaw_before: float) -> Vec3:
    """Return φ, θ, ψ with φ in (−π, π], θ in [−π/2, π/2], and ψ within π of `yaw_before`, so that it is continuous."""
    cos_pitch = np.sqrt(rotation.y.z * rotation.y.z + rotation.z.z * rotation.z.z)
    yaw = arctan2(rotation.x.y, rotation.x.x)
    turns = np.rint((yaw_before - yaw) * (0.5 / np.pi))
    return Vec3(arctan2(rotation.y.z, rotation.z.z), arctan2(-rotation.x.z, cos_pitch), yaw + 2.0 * np.pi * turns)


@inlined
def euler_rate(rotation: Rotation, rate: Vec3) -> Vec3:
    """Return the rates of the Euler angles, equation (4), with cos θ bounded from below."""
    cos_pitch = np.sqrt(rotation.y.z * rotation.y.z + rotation.z.z * rotation.z.z)
    per_cos = 1.0 / max(cos_pitch, _MIN_COS_PITCH)
    sin_roll, cos_roll = rotation.y.z * per_cos, rotation.z.z * per_cos
    yaw_rate = (rate.y * sin_roll + rate.z * cos_roll) * per_cos
    return Vec3(rate.x - yaw_rate * rotation.x.z, rate.y * cos_roll - rate.z * sin_roll, yaw_rate)


@inlined
def body_rate(euler: Vec3, rate: Vec3) -> Vec3:
    """Return ω, equation (3), from the Euler angles and their rates."""
    sin_roll, cos_roll = sincos(euler.x)
    sin_pitch, cos_pitch = sincos(euler.y)
    return Vec3(
        rate.x - rate.z * sin_pitch,
        rate.y * cos_roll + rate.z * sin_roll * cos_pitch,
        rate.z * cos_roll * cos_pitch - rate.y * sin_roll,
    )
