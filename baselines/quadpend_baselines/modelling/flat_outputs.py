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

The equations are exact except for the term l r̈_z in (1), which is left out: the vertical acceleration of the bob
relative to the quadrotor. It appears because the height z is that of the quadrotor. It is of second order in the tilt
and zero on circles; including it would require derivatives of F of order above six.

| symbol         | code name           | unit | frame | shape     |
|----------------|---------------------|------|-------|-----------|
| s              | `pendulum_tangent`  | 1    | world | (k, n, 2) |
| r_z            | `pendulum_vertical` | 1    | world | (k, n)    |
| u_z            | `vertical_thrust`   | N    | world | (k, n)    |
| t              | `thrust_tangent`    | 1    | world | (k, n, 2) |
| G              | `bob_gravity`       | m/s² | world | (k, n)    |
| κ              | `stiffness`         | 1/s² |       | (k, n, 1) |
| δ              | `drift`             | 1/s² | world | (k, n, 2) |
"""

from typing import NamedTuple

import numpy as np

from quadpend_baselines.modelling import taylor
from quadpend_gym import Parameters
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import STATE_SIZE, Disturbance, State


class FlatTrajectory(NamedTuple):
    """Trajectories of n rows as Taylor series in time; horizontal vectors are in the world frame."""

    pendulum_tangent: Floats  # s, shape (5, n, 2)
    pendulum_vertical: Floats  # r_z, shape (5, n)
    vertical_thrust: Floats  # u_z, N, shape (3, n)
    thrust_tangent: Floats  # t, shape (3, n, 2)


def flat_trajectory(reference: Floats, disturbance: Floats, p: Parameters) -> FlatTrajectory:
    """Return the trajectory that follows a reference, by equations (1)–(4).

    The reference has F_d⁽ⁱ⁾ of (F_x, F_y, z) for i = 2 … 6, shape (n, 5, 3); d_Q (N), d_B (N) and d_τ (N·m), shape
    (n, 9), are taken as constant.
    """
    acceleration = taylor.from_derivatives(*np.moveaxis(reference, 1, 0))
    horizontal, vertical = acceleration[..., :2], acceleration[..., 2]
    force, bob_force = Disturbance(disturbance).force, Disturbance(disturbance).bob_force
    bob_acceleration = horizontal - taylor.constant(bob_force[:, :2] / p.bob_mass, 4)
    bob_gravity = vertical + taylor.constant(p.gravity - bob_force[:, 2] / p.bob_mass, 4)
    pendulum = taylor.quotient(bob_acceleration, bob_gravity[..., np.newaxis])
    r_z = vertical_component(pendulum)
    r_z_acceleration = taylor.derivative(r_z, 2)
    mass, per_rod = p.quadrotor_mass, 1.0 / (p.quadrotor_mass * p.rod_length)
    thrust = p.total_mass * vertical[:3] + p.bob_mass * p.rod_length * r_z_acceleration
    thrust[0] += p.hover_thrust - force[:, 2] - bob_force[:, 2]
    stiffness = taylor.quotient(thrust, r_z)[..., np.newaxis] * per_rod
    drift = taylor.constant(mass / p.bob_mass * bob_force[:, :2] - force[:, :2], 2)
    drift -= pendulum[:3] * (mass / p.bob_mass * bob_force[:, 2:] - force[:, 2:])
    drift = per_rod * taylor.quotient(drift, r_z[..., np.newaxis])
    relative_rate = taylor.quotient(taylor.derivative(r_z), r_z)[..., np.newaxis]
    drift -= 2.0 * taylor.product(taylor.derivative(pendulum), relative_rate)[:3]
    tangent = pendulum[:3] - taylor.quotient(taylor.derivative(pendulum, 2) - drift, stiffness)
    return FlatTrajectory(pendulum, r_z, thrust, tangent)


def vertical_component(tangent: Floats) -> Floats:
    """Return the series of r_z, shape (k, n), from that of s, shape (k, n, 2), by equation (4)."""
    squared = np.sum(taylor.product(tangent, tangent), axis=-1)
    squared[0] += 1.0
    return taylor.power(squared, -0.5)


def rotate_series(vector: Floats, yaw: Floats) -> Floats:
    """Rotate horizontal vectors about the vertical; Taylor series of shapes (k, n, 2) and (k, n)."""
    sine, cosine = taylor.sine_and_cosine(yaw)
    x, y = vector[..., 0], vector[..., 1]
    rotated_x = taylor.product(cosine, x) - taylor.product(sine, y)
    return np.stack([rotated_x, taylor.product(sine, x) + taylor.product(cosine, y)], axis=-1)


def attitude_from_tangent(tangent: Floats, yaw: Floats) -> Floats:
    """Return the series of φ, θ, ψ, shape (k, n, 3), from t and ψ, shapes (k, n, 2) and (k, n), by equation (5)."""
    forward, lateral = np.moveaxis(rotate_series(tangent, -yaw), -1, 0)
    squared = taylor.product(forward, forward)
    squared[0] += 1.0
    roll = -taylor.arctangent(taylor.product(lateral, taylor.power(squared, -0.5)))
    return np.stack([roll, taylor.arctangent(forward), yaw], axis=-1)


def tangent_from_attitude(euler: Floats) -> Floats:
    """Return the series of t, shape (k, n, 2), from that of φ, θ, ψ, shape (k, n, 3), by equation (5)."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = (taylor.sine_and_cosine(euler[..., i]) for i in (0, 1))
    lateral = -taylor.quotient(taylor.quotient(sin_roll, cos_roll), cos_pitch)
    return rotate_series(np.stack([taylor.quotient(sin_pitch, cos_pitch), lateral], axis=-1), euler[..., 2])


def state_and_command(
    trajectory: FlatTrajectory, yaw_reference: Floats, disturbance: Floats, p: Parameters
) -> tuple[Floats, Floats]:
    """Return state and command at the start of a trajectory, in the layouts of `equivalent.EquivalentModel.trajectory`.

    The yaw reference has ψ_d, ψ̇_d, ψ̈_d in rad, rad/s, rad/s², shape (n, 3); the disturbance is as in `flat_trajectory`.
    """
    state = np.zeros((len(yaw_reference), STATE_SIZE))
    s = State(state)
    r_z = trajectory.pendulum_vertical[..., np.newaxis]
    direction = np.concatenate([taylor.product(trajectory.pendulum_tangent, r_z), r_z], axis=-1)
    s.direction[:], s.direction_rate[:] = direction[:2]
    s.position[:, :2], s.velocity[:, :2] = -p.rod_length * direction[:2, :, :2]
    attitude = attitude_from_tangent(trajectory.thrust_tangent, taylor.from_derivatives(*yaw_reference.T))
    euler = taylor.to_derivatives(attitude)
    s.euler[:], s.euler_rate[:] = euler[:2]
    roll, pitch, _ = euler[0].T
    thrust = trajectory.vertical_thrust[0] / (np.cos(roll) * np.cos(pitch))
    inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    return state, np.column_stack([thrust, inertia * euler[2] - Disturbance(disturbance).torque])
