"""Differential flatness: the state and the command that follow a reference under a known disturbance.

The equations use the tangents s = r_xy/r_z of the pendulum and t = b_xy/b_z of the thrust axis b = R e₃. F is the
horizontal position of the bob, z the height of the quadrotor, and u_z = u b_z the vertical thrust:

    (1)  F̈  = G s + d_B/m_c,                     G  = g + z̈ − d_Bz/m_c (+ l r̈_z)
    (2)  s̈  = κ (s − t) + δ,                     κ  = u_z/(r_z M l)
    (3)  δ  = (M/m_c (d_B − s d_Bz) − (d_Q − s d_Qz))/(r_z M l) − 2 ṡ ṙ_z/r_z
    (4)  u_z = (M + m_c)(g + z̈) + m_c l r̈_z − d_Qz − d_Bz,      r_z = (1 + |s|²)^(−1/2)
    (5)  t  = (tan θ, −tan φ/cos θ), rotated by ψ

The term in parentheses is left out, see below. The radial component of r̈ cancels in s̈, so (2) holds at every tilt below
90°. Equation (1) is solved for s, (2) for t, and (5) for the attitude; six derivatives of F therefore determine the
torque. All quantities are Taylor series in time (see `taylor`).

d_Q and d_B are constant but for the drag on the trajectory, see `trajectory_drag`.

The equations are exact except for the term l r̈_z in (1), which is left out: the vertical acceleration of the bob
relative to the quadrotor. It appears because the height z is that of the quadrotor. It is of second order in the tilt
and zero on circles; including it would require derivatives of F of order above six.

| symbol | code name          | unit | frame | known to order |
|--------|--------------------|------|-------|----------------|
| s      | `pendulum`         | 1    | world | 4              |
| r_z    | `vertical`         | 1    | world | 4              |
| u_z    | `thrust`           | N    | world | 2              |
| t      | `tangent`          | 1    | world | 2              |
| G      | `gravity`          | m/s² | world | 4              |
| κ      | `stiffness`        | 1/s² |       | 2              |
| δ      | `drift`            | 1/s² | world | 2              |
"""

from typing import NamedTuple

from quadpend_baselines.modelling.quantities import Derivatives, VehicleState
from quadpend_baselines.modelling.taylor import (
    Pair,
    Series,
    Triple,
    arctangent,
    combined,
    derivative,
    from_derivatives,
    inverse_root,
    plus,
    product,
    quotient,
    shift,
    sincos_series,
    times,
)
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Four, Vec3
from quadpend_gym.vehicles import Parameters


class FlatTrajectory(NamedTuple):
    """A trajectory as Taylor series in time; horizontal vectors are in the world frame."""

    pendulum: Pair  # s
    vertical: Series  # r_z
    thrust: Series  # u_z, N
    tangent: Pair  # t


@inlined
def flat_trajectory(reference: Derivatives, forces: tuple[Triple, Triple], p: Parameters) -> FlatTrajectory:
    """Return the trajectory that follows a reference under forces on quadrotor and bob, by equations (1)–(4)."""
    d2, d3, d4, d5, d6 = reference.d2, reference.d3, reference.d4, reference.d5, reference.d6
    (body, bob), mass, bob_mass, length = forces, p.quadrotor_mass, p.bob_mass, p.rod_length
    vertical_acceleration = from_derivatives(d2.z, d3.z, d4.z, d5.z, d6.z)
    gravity = plus(shift(p.gravity, vertical_acceleration), times(-1.0 / bob_mass, bob.z))
    forward = plus(from_derivatives(d2.x, d3.x, d4.x, d5.x, d6.x), times(-1.0 / bob_mass, bob.x))
    sideward = plus(from_derivatives(d2.y, d3.y, d4.y, d5.y, d6.y), times(-1.0 / bob_mass, bob.y))
    s = Pair(quotient(forward, gravity), quotient(sideward, gravity))
    r_z = vertical_component(s)
    lift = times(mass + bob_mass, shift(p.gravity, vertical_acceleration))
    inner = times(bob_mass * length, derivative(derivative(r_z)))
    thrust = plus(plus(lift, inner), times(-1.0, plus(body.z, bob.z)))
    per_rod = quotient(Series(1.0 / (mass * length), 0.0, 0.0, 0.0, 0.0), r_z)  # 1/(r_z M l)
    stiffness = product(per_rod, thrust)
    relative = combined(mass / bob_mass, bob, -1.0, body)
    closing = times(-2.0, quotient(derivative(r_z), r_z))
    tangent = Pair(
        _tangent(s.x, relative.x, relative.z, per_rod, closing, stiffness),
        _tangent(s.y, relative.y, relative.z, per_rod, closing, stiffness),
    )
    return FlatTrajectory(s, r_z, thrust, tangent)


@inlined
def _tangent(
    s: Series, relative: Series, vertical: Series, per_rod: Series, closing: Series, stiffness: Series
) -> Series:
    """Return t of one axis by equations (2) and (3); `relative` is M/m_c d_B − d_Q, `closing` is −2 ṙ_z/r_z."""
    acting = plus(relative, times(-1.0, product(vertical, s)))
    drift = plus(product(acting, per_rod), product(derivative(s), closing))
    excess = plus(derivative(derivative(s)), times(-1.0, drift))
    return plus(s, times(-1.0, quotient(excess, stiffness)))


@inlined
def vertical_component(s: Pair) -> Series:
    """Return the series of r_z from that of s, by equation (4)."""
    return inverse_root(shift(1.0, plus(product(s.x, s.x), product(s.y, s.y))))


@inlined
def _rotated(vector: Pair, sine: Series, cosine: Series) -> Pair:
    x, y = vector.x, vector.y
    return Pair(
        plus(product(cosine, x), times(-1.0, product(sine, y))),
        plus(product(sine, x), product(cosine, y)),
    )


@inlined
def attitude_from_tangent(tangent: Pair, yaw: Series) -> tuple[Series, Series]:
    """Return the series of φ and θ from those of t and ψ, by equation (5)."""
    sine, cosine = sincos_series(yaw)
    forward = _rotated(tangent, times(-1.0, sine), cosine)
    per_length = inverse_root(shift(1.0, product(forward.x, forward.x)))
    return times(-1.0, arctangent(product(forward.y, per_length))), arctangent(forward.x)


@inlined
def euler_accelerations(t: Vec3, rate: Vec3, acceleration: Vec3, yaw: Vec3) -> Vec3:
    """Return φ̈, θ̈ and ψ̈ from t, ṫ, ẗ and (ψ, ψ̇, ψ̈)."""
    x, y = Series(t.x, rate.x, 0.5 * acceleration.x, 0.0, 0.0), Series(t.y, rate.y, 0.5 * acceleration.y, 0.0, 0.0)
    roll, pitch = attitude_from_tangent(Pair(x, y), Series(yaw.x, yaw.y, yaw.z / 2.0, 0.0, 0.0))
    return Vec3(2.0 * roll.c, 2.0 * pitch.c, yaw.z)


@inlined
def coefficients(vector: Pair) -> tuple[Vec3, Vec3, Vec3]:
    """Return the Taylor coefficients of order 0, 1 and 2 of a horizontal vector."""
    x, y = vector.x, vector.y
    return Vec3(x.a, y.a, 0.0), Vec3(x.b, y.b, 0.0), Vec3(x.c, y.c, 0.0)


@inlined
def tangent_from_attitude(euler: Vec3, rate: Vec3) -> Pair:
    """Return the series of t, known to order 1, from φ, θ, ψ and their rates, by equation (5)."""
    sin_roll, cos_roll = sincos_series(Series(euler.x, rate.x, 0.0, 0.0, 0.0))
    sin_pitch, cos_pitch = sincos_series(Series(euler.y, rate.y, 0.0, 0.0, 0.0))
    sine, cosine = sincos_series(Series(euler.z, rate.z, 0.0, 0.0, 0.0))
    lateral = times(-1.0, quotient(quotient(sin_roll, cos_roll), cos_pitch))
    return _rotated(Pair(quotient(sin_pitch, cos_pitch), lateral), sine, cosine)


@inlined
def state_and_command(
    trajectory: FlatTrajectory, yaw: Vec3, torque: Vec3, p: Parameters, length: float
) -> tuple[VehicleState, Four]:
    """Return the state and the command at the start of a trajectory, for ψ_d, ψ̇_d, ψ̈_d and d_τ.

    Position and velocity of the state are relative to the reference. They follow from those of the bob at the distance
    `length` from the quadrotor.
    """
    x, y = product(trajectory.pendulum.x, trajectory.vertical), product(trajectory.pendulum.y, trajectory.vertical)
    roll, pitch = attitude_from_tangent(trajectory.tangent, Series(yaw.x, yaw.y, yaw.z / 2.0, 0.0, 0.0))
    state = VehicleState(
        Vec3(-length * x.a, -length * y.a, 0.0),
        Vec3(-length * x.b, -length * y.b, 0.0),
        Vec3(roll.a, pitch.a, yaw.x),
        Vec3(roll.b, pitch.b, yaw.y),
        Vec3(x.a, y.a, trajectory.vertical.a),
        Vec3(x.b, y.b, trajectory.vertical.b),
    )
    thrust = trajectory.thrust.a / (sincos(roll.a)[1] * sincos(pitch.a)[1])
    roll_torque, pitch_torque = p.inertia_roll * 2.0 * roll.c - torque.x, p.inertia_pitch * 2.0 * pitch.c - torque.y
    return state, Four(thrust, roll_torque, pitch_torque, p.inertia_yaw * yaw.z - torque.z)
