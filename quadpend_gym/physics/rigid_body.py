"""Equations of motion of a rigid quadrotor with a pole on a pivot anywhere in its body, on R³ × SO(3) × S².

A ball joint without friction holds the pole at the point p of the body. With the force on the quadrotor
F = u R e₃ + d_Q, the force d_B on the pole, both at the centres of mass, the torque d_τ on the body, and the force N
that the body exerts on the pole at the pivot:

    (1)  ω̇₀ = I⁻¹ (τ + Rᵀ d_τ − ω × (I ω + h e₃))                        body rate without the pole
    (2)  a₀ = u e₃/M + Rᵀ (d_Q/M − d_B/m) + ω̇₀ × p + ω × (ω × p)         pivot without the pole, relative to a free pole
    (3)  W  = 1/M − [p]× I⁻¹ [p]×                                        acceleration of the pivot for each newton
    (4)  A  = ρ ρᵀ + j (1 − ρ ρᵀ),   j = J/(J + m l²),   ρ = Rᵀ r
    (5)  (1 + m A W) N = m (A a₀ − l (ṙ·ṙ) ρ)                            force at the pivot
    (6)  ω̇ = ω̇₀ − I⁻¹ (p × N)                                            body rate
    (7)  a = a₀ − W N,   w = −R a/λ,   λ = l + J/(m l)
    (8)  r̈ = w − (r·w + ṙ·ṙ) r                                           pendulum, equation (3) of `dynamics`
    (9)  Ẍ = (F + d_B)/(M + m) − g e₃                                    centre of mass, equation (4) of `dynamics`,
                                                                         X = ζ + m (R p + l r)/(M + m)

Equations (1) to (7) are in the body frame, in which I, W and p are constant. (5) is solved with the constant matrix
C = 1 + m j W and the Sherman–Morrison formula, since 1 + m A W = C + m (1 − j) ρ (W ρ)ᵀ. With p = 0 and J = 0, N is
parallel to r, and (7) and (8) are equations (3) of `dynamics`. The paper's attitude model is not a limit of (1): it has
a constant inertia in the Euler angles. Both agree to second order near hover.

| symbol | code name                    | unit   | frame | meaning                                                     |
|--------|------------------------------|--------|-------|-------------------------------------------------------------|
| I      | `inertia`                    | kg·m²  | body  | inertia of the body about its centre of mass                |
| M, m   | `quadrotor_mass`, `bob_mass` | kg     |       | masses of body and pole                                     |
| l      | `rod_length`                 | m      |       | distance of the pole's centre of mass from the pivot        |
| J      | `shape` · m l²               | kg·m²  |       | inertia of the pole about its centre of mass, transverse    |
| λ      | `oscillation_length`         | m      |       | distance of the pole's centre of oscillation from the pivot |
| p      | `pivot`                      | m      | body  | pivot, from the body's centre of mass                       |
| h      | `momentum`                   | N·m·s  | body  | angular momentum of the propellers along e₃                 |
| u, τ   | `thrust`, `torque`           | N, N·m | body  | thrust along R e₃, and torque                               |
| a₀, a  | `relative`, `pivot`          | m/s²   | body  | accelerations of (2) and (7)                                |

The equations are those of Newton and Euler for both bodies with the constraint of the joint. Tests compare them with a
Lagrangian that sympy differentiates and with MuJoCo.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.attitude import (
    Quaternion,
    Rotation,
    quaternion_axpy,
    quaternion_rate,
    rotation_matrix,
    to_body,
    to_world,
)
from quadpend_gym.physics.dynamics import centre_acceleration, direction_acceleration
from quadpend_gym.physics.vectors import (
    Symmetric,
    Vec3,
    add,
    apply,
    axpy,
    centripetal,
    cross,
    dot,
    inverse,
    load_symmetric,
    scale,
    store_symmetric,
)
from quadpend_gym.vehicles import Parameters


class RigidPhysics(NamedTuple):
    """What equations (1) to (9) need of a body with a pole; constant during a control period."""

    inertia: Symmetric  # I, kg·m²
    per_inertia: Symmetric  # I⁻¹, 1/(kg·m²)
    mobility: Symmetric  # W, 1/kg
    per_coupling: Symmetric  # C⁻¹, 1
    pivot: Vec3  # p, m
    shape: float  # J/(m l²), 1


class Wrench(NamedTuple):
    """Thrust along R e₃ in N, and torque in the body frame in N·m."""

    thrust: float
    torque: Vec3


class Loads(NamedTuple):
    """What acts on the two bodies besides the rotors; constant during a substep."""

    force: Vec3  # d_Q with the drag, N, world frame
    bob_force: Vec3  # d_B with the drag, N, world frame
    relative: Vec3  # d_Q/M − d_B/m, m/s², world frame
    torque: Vec3  # d_τ, N·m, world frame
    momentum: float  # h, N·m·s
    angular_drag: Vec3  # coefficients of the torque against ω, N·m·s/rad, body frame


class Motion(NamedTuple):
    """Attitude q, body rate ω, direction r and direction rate ṙ, or their time derivatives."""

    attitude: Quaternion
    rate: Vec3
    direction: Vec3
    direction_rate: Vec3


class Derivative(NamedTuple):
    """Time derivative of a `Motion`, and Ẍ."""

    motion: Motion
    centre: Vec3


@inlined
def rigid_physics(physics: Parameters, correlation: Vec3, pivot: Vec3, shape: float) -> RigidPhysics:
    """Return the constants of a body, see `RigidSettings` for the arguments."""
    moments = Vec3(physics.inertia_roll, physics.inertia_pitch, physics.inertia_yaw)
    root, c = Vec3(np.sqrt(moments.x), np.sqrt(moments.y), np.sqrt(moments.z)), correlation
    products = Vec3(c.x * root.x * root.y, c.y * root.x * root.z, c.z * root.y * root.z)
    inertia = Symmetric(moments.x, moments.y, moments.z, products.x, products.y, products.z)
    per_inertia, per_mass = inverse(inertia), 1.0 / physics.quadrotor_mass
    x = cross(pivot, apply(per_inertia, Vec3(0.0, pivot.z, -pivot.y)))  # columns of −[p]× I⁻¹ [p]×
    y = cross(pivot, apply(per_inertia, Vec3(-pivot.z, 0.0, pivot.x)))
    z = cross(pivot, apply(per_inertia, Vec3(pivot.y, -pivot.x, 0.0)))
    mobility = Symmetric(per_mass - x.x, per_mass - y.y, per_mass - z.z, -y.x, -z.x, -z.y)
    mj = physics.bob_mass * shape / (1.0 + shape)
    coupling = Symmetric(
        1.0 + mj * mobility.xx,
        1.0 + mj * mobility.yy,
        1.0 + mj * mobility.zz,
        mj * mobility.xy,
        mj * mobility.xz,
        mj * mobility.yz,
    )
    return RigidPhysics(inertia, per_inertia, mobility, inverse(coupling), pivot, shape)


@inlined
def oscillation_length(physics: Parameters, body: RigidPhysics) -> float:
    """Return λ = l + J/(m l) in m."""
    return physics.rod_length * (1.0 + body.shape)


@inlined
def free_body_rate(rate: Vec3, wrench: Wrench, loads: Loads, rotation: Rotation, body: RigidPhysics) -> Vec3:
    """Return ω̇₀, equation (1), with the angular drag."""
    spin = apply(body.inertia, rate)
    gyroscopic = cross(rate, Vec3(spin.x, spin.y, spin.z + loads.momentum))
    torque = axpy(-1.0, gyroscopic, add(wrench.torque, to_body(rotation, loads.torque)))
    drag = loads.angular_drag
    return apply(
        body.per_inertia,
        Vec3(torque.x - drag.x * rate.x, torque.y - drag.y * rate.y, torque.z - drag.z * rate.z),
    )


@inlined
def pivot_force(relative: Vec3, direction: Vec3, squared_rate: float, physics: Parameters, body: RigidPhysics) -> Vec3:
    """Return N, equations (4) and (5); `relative` is a₀, `direction` is ρ and `squared_rate` is ṙ·ṙ."""
    mass, share = physics.bob_mass, body.shape / (1.0 + body.shape)
    along = (1.0 - share) * dot(direction, relative) - physics.rod_length * squared_rate
    load = axpy(along, direction, scale(share, relative))  # (5) is divided by m
    force, reach = apply(body.per_coupling, load), apply(body.per_coupling, direction)
    mobile = scale(mass * (1.0 - share), apply(body.mobility, direction))
    return scale(mass, axpy(-dot(mobile, force) / (1.0 + dot(mobile, reach)), reach, force))


@inlined
def derivative(motion: Motion, wrench: Wrench, loads: Loads, physics: Parameters, body: RigidPhysics) -> Derivative:
    """Return the time derivative of the motion and Ẍ, equations (1) to (9)."""
    rotation = rotation_matrix(motion.attitude)
    free = free_body_rate(motion.rate, wrench, loads, rotation, body)
    swing = add(cross(free, body.pivot), centripetal(motion.rate, body.pivot))
    lift = Vec3(0.0, 0.0, (1.0 / physics.quadrotor_mass) * wrench.thrust)
    relative = add(lift, add(to_body(rotation, loads.relative), swing))
    direction_rate = motion.direction_rate
    squared_rate = dot(direction_rate, direction_rate)
    force = pivot_force(relative, to_body(rotation, motion.direction), squared_rate, physics, body)
    rate_dot = axpy(-1.0, apply(body.per_inertia, cross(body.pivot, force)), free)
    pivot = axpy(-1.0, apply(body.mobility, force), relative)
    w = scale(-1.0 / oscillation_length(physics, body), to_world(rotation, pivot))
    return Derivative(
        Motion(
            quaternion_rate(motion.attitude, motion.rate),
            rate_dot,
            direction_rate,
            direction_acceleration(motion.direction, direction_rate, w),
        ),
        centre_acceleration(axpy(wrench.thrust, rotation.z, loads.force), loads.bob_force, physics),
    )


@inlined
def centre_from_body(rotation: Rotation, direction: Any, physics: Parameters, body: RigidPhysics) -> Vec3:
    """Return X − ζ = m (R p + l r)/(M + m) in m."""
    share = physics.bob_mass / (physics.quadrotor_mass + physics.bob_mass)
    return scale(share, axpy(physics.rod_length, direction, to_world(rotation, body.pivot)))


@inlined
def centre_rate_from_body(
    rotation: Rotation, rate: Vec3, direction_rate: Vec3, physics: Parameters, body: RigidPhysics
) -> Vec3:
    """Return Ẋ − ζ̇ = m (R (ω × p) + l ṙ)/(M + m) in m/s."""
    share = physics.bob_mass / (physics.quadrotor_mass + physics.bob_mass)
    return scale(share, axpy(physics.rod_length, direction_rate, to_world(rotation, cross(rate, body.pivot))))


@inlined
def moved(factor: float, rate: Motion, motion: Motion) -> Motion:
    """Return motion + factor · rate."""
    return Motion(
        quaternion_axpy(factor, rate.attitude, motion.attitude),
        axpy(factor, rate.rate, motion.rate),
        axpy(factor, rate.direction, motion.direction),
        axpy(factor, rate.direction_rate, motion.direction_rate),
    )


# A body's constants in a (field, lane) buffer: four symmetric matrices.
_INERTIA, _PER_INERTIA, _MOBILITY, _PER_COUPLING, LANE_BODY_SIZE = 0, 6, 12, 18, 24


@inlined
def load_body(lanes: Any, first: int, lane: int, pivot: Vec3, shape: float) -> RigidPhysics:
    """Return the constants that `store_body` wrote."""
    return RigidPhysics(
        load_symmetric(lanes, first + _INERTIA, lane),
        load_symmetric(lanes, first + _PER_INERTIA, lane),
        load_symmetric(lanes, first + _MOBILITY, lane),
        load_symmetric(lanes, first + _PER_COUPLING, lane),
        pivot,
        shape,
    )


@inlined
def store_body(lanes: Any, first: int, lane: int, body: RigidPhysics) -> None:
    """Write the matrices of a body into the fields from `first` in column `lane` of a (field, lane) buffer."""
    store_symmetric(lanes, first + _INERTIA, lane, body.inertia)
    store_symmetric(lanes, first + _PER_INERTIA, lane, body.per_inertia)
    store_symmetric(lanes, first + _MOBILITY, lane, body.mobility)
    store_symmetric(lanes, first + _PER_COUPLING, lane, body.per_coupling)
