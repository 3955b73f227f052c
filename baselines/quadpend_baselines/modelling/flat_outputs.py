"""From the flat outputs to the whole flight: which state and command follow a reference exactly, in a known wind.

In the tangents s = r_xy/r_z of the pendulum and t = b_xy/b_z of the thrust axis b = R e₃, with the bob's horizontal
position F, the quadrotor's height z and the vertical thrust u_z = u b_z:

    (1)  F̈  = G s + d_B/m_c,                     G  = g + z̈ − d_Bz/m_c (+ l r̈_z)
    (2)  s̈  = κ (s − t) + δ,                     κ  = u_z/(r_z M l)
    (3)  δ  = (M/m_c (d_B − s d_Bz) − (d_Q − s d_Qz))/(r_z M l) − 2 ṡ ṙ_z/r_z
    (4)  u_z = (M + m_c)(g + z̈) + m_c l r̈_z − d_Qz − d_Bz,      r_z = (1 + |s|²)^(−1/2)
    (5)  t  = (tan θ, −tan φ/cos θ), turned by ψ

In tangents what is radial cancels, so (2) holds at any tilt. Read from right to left, (1) gives s of F̈, (2) t of s̈
and (5) the attitude of t; six derivatives of F give the torque. All of it is Taylor series (`jets`). Exact, but for the
bob's own rise l r̈_z in (1), which is left out: of second order in the tilt and zero on circles, it comes of the height
being the quadrotor's, and would need derivatives of F beyond the sixth.
"""

from typing import NamedTuple

import numpy as np

from quadpend_baselines.modelling import taylor
from quadpend_gym import Parameters
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import STATE_SIZE, State


class FlatTrajectory(NamedTuple):
    """How n rows follow their references, as jets; horizontal vectors in the world frame.

    Attributes:
        pendulum: s, shape (5, n, 2).
        upright: r_z, shape (5, n).
        lift: u_z, N, shape (3, n).
        lean: t, shape (3, n, 2).
    """

    pendulum: Floats
    upright: Floats
    lift: Floats
    lean: Floats


def flat_trajectory(reference: Floats, disturbance: Floats, p: Parameters) -> FlatTrajectory:
    """Equations (1)–(4).

    Args:
        reference: F_d⁽ⁱ⁾ of (F_x, F_y, z) for i = 2 … 6, shape (n, 5, 3).
        disturbance: d_Q (N), d_B (N), d_τ (N·m), held constant, shape (n, 9).
        p: the physical parameters.
    """
    acceleration = taylor.from_derivatives(*np.moveaxis(reference, 1, 0))
    on_quadrotor, on_bob = disturbance[:, 0:3], disturbance[:, 3:6]
    pull = acceleration[..., :2] - taylor.constant(on_bob[:, :2] / p.bob_mass, 4)
    weight = acceleration[..., 2] + taylor.constant(p.gravity - on_bob[:, 2] / p.bob_mass, 4)
    pendulum = taylor.quotient(pull, weight[..., np.newaxis])
    upright = vertical_component(pendulum)
    rise = taylor.derivative(upright, 2)
    mass, per_rod = p.quadrotor_mass, 1.0 / (p.quadrotor_mass * p.rod_length)
    lift = p.total_mass * acceleration[:3, :, 2] + p.bob_mass * p.rod_length * rise
    lift[0] += p.hover_thrust - on_quadrotor[:, 2] - on_bob[:, 2]
    steepness = taylor.quotient(lift, upright)[..., np.newaxis] * per_rod
    drift = taylor.constant(mass / p.bob_mass * on_bob[:, :2] - on_quadrotor[:, :2], 2)
    drift -= pendulum[:3] * (mass / p.bob_mass * on_bob[:, 2:] - on_quadrotor[:, 2:])
    drift = per_rod * taylor.quotient(drift, upright[..., np.newaxis])
    turning = taylor.quotient(taylor.derivative(upright), upright)[..., np.newaxis]
    drift -= 2.0 * taylor.product(taylor.derivative(pendulum), turning)[:3]
    lean = pendulum[:3] - taylor.quotient(taylor.derivative(pendulum, 2) - drift, steepness)
    return FlatTrajectory(pendulum, upright, lift, lean)


def vertical_component(pendulum: Floats) -> Floats:
    """r_z of s, shapes (k, n) and (k, n, 2)."""
    squared = np.sum(taylor.product(pendulum, pendulum), axis=-1)
    squared[0] += 1.0
    return taylor.power(squared, -0.5)


def rotate_series(vector: Floats, yaw: Floats) -> Floats:
    """Horizontal vectors turned about the vertical, jets of shapes (k, n, 2) and (k, n)."""
    sine, cosine = taylor.sine_and_cosine(yaw)
    a, b = vector[..., 0], vector[..., 1]
    first = taylor.product(cosine, a) - taylor.product(sine, b)
    return np.stack([first, taylor.product(sine, a) + taylor.product(cosine, b)], axis=-1)


def attitude_from_tangent(lean: Floats, yaw: Floats) -> Floats:
    """φ, θ, ψ of equation (5), jets of shape (k, n, 3), from t and ψ, shapes (k, n, 2) and (k, n)."""
    ahead, aside = np.moveaxis(rotate_series(lean, -yaw), -1, 0)
    squared = taylor.product(ahead, ahead)
    squared[0] += 1.0
    roll = -taylor.arctangent(taylor.product(aside, taylor.power(squared, -0.5)))
    return np.stack([roll, taylor.arctangent(ahead), yaw], axis=-1)


def tangent_from_attitude(euler: Floats) -> Floats:
    """t of equation (5), shape (k, n, 2), from φ, θ, ψ, jets of shape (k, n, 3)."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = (taylor.sine_and_cosine(euler[..., i]) for i in (0, 1))
    aside = -taylor.quotient(taylor.quotient(sin_roll, cos_roll), cos_pitch)
    return rotate_series(np.stack([taylor.quotient(sin_pitch, cos_pitch), aside], axis=-1), euler[..., 2])


def state_and_command(
    flight: FlatTrajectory, yaw_reference: Floats, disturbance: Floats, p: Parameters
) -> tuple[Floats, Floats]:
    """The state, in the reference's frame, and thrust and torques of a flight.

    Args:
        flight: of n rows.
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d, shape (n, 3).
        disturbance: as in `fly`.
        p: the physical parameters.

    Returns:
        Shapes (n, 18) and (n, 4); positions and velocities are those beside the reference's.
    """
    state = np.zeros((len(yaw_reference), STATE_SIZE))
    s = State(state)
    upright = flight.upright[..., np.newaxis]
    direction = np.concatenate([taylor.product(flight.pendulum, upright), upright], axis=-1)
    s.direction[:], s.direction_rate[:] = direction[:2]
    s.position[:, :2], s.velocity[:, :2] = -p.rod_length * direction[:2, :, :2]
    euler = taylor.to_derivatives(attitude_from_tangent(flight.lean, taylor.from_derivatives(*yaw_reference.T)))
    s.euler[:], s.euler_rate[:] = euler[:2]
    thrust = flight.lift[0] / (np.cos(euler[0, :, 0]) * np.cos(euler[0, :, 1]))
    inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    return state, np.column_stack([thrust, inertia * euler[2] - disturbance[:, 6:9]])
