"""Equations of motion on R³ × R³ × S², free of the paper's singularity and of any matrix inverse.

With the force on the quadrotor F = u R e₃ + d_Q, the force on the bob d_B, the torque d_τ and the pull on the rod
w = (d_B/m_c − F/M) / l:

    (1)  R e₃ = (cψ sθ cφ + sψ sφ,  sψ sθ cφ − cψ sφ,  cθ cφ)       thrust axis
    (2)  η̈    = I⁻¹ (τ + d_τ)                                       attitude
    (3)  r̈    = w − (r·w + ṙ·ṙ) r                                   pendulum
    (4)  Ẍ    = (F + d_B) / (M + m_c) − g e₃                        centre of mass X = ζ + μ r,  μ = m_c l/(M + m_c)
    (5)  ζ̈    = Ẍ − μ r̈                                             quadrotor

(3) is the bob's acceleration relative to the quadrotor with the rod's force projected out; (4) holds because that
force is internal. They are the Euler–Lagrange equations (7) of the paper, proven in ``tests/quadpend_gym/physics/test_lagrangian.py``
against a Lagrangian derived by sympy and in ``tests/quadpend_gym/physics/test_mujoco.py`` against a rigid-body engine.

| symbol   | code name          | unit        | frame        | shape  |
|----------|--------------------|-------------|--------------|--------|
| u        | thrust             | N           | along R e₃   | scalar |
| τ        | torque             | N·m         | φ, θ, ψ axes | 3      |
| d_Q, d_B | force on quad, bob | N           | world        | 3, 3   |
| d_τ      | torque disturbance | N·m         | φ, θ, ψ axes | 3      |
| w        | pull               | 1/s²        | world        | 3      |
| μ        | offset             | m           |              | scalar |
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.parameters import (
    BOB_MASS,
    GRAVITY,
    INERTIA_PITCH,
    INERTIA_ROLL,
    INERTIA_YAW,
    PARAMETERS_SIZE,
    QUADROTOR_MASS,
    ROD_LENGTH,
    Parameters,
)
from quadpend_gym.physics.state import (
    BOB_FORCE,
    COMMAND_TORQUE,
    DIRECTION,
    DIRECTION_RATE,
    EULER,
    FORCE,
    THRUST,
    TORQUE,
    State,
)
from quadpend_gym.physics.vectors import Vec3, axpy, dot, load, scale


class Physics(NamedTuple):
    """The parameters that the equations have, inside a kernel; `params.Parameters` has their units."""

    quadrotor_mass: float
    bob_mass: float
    rod_length: float
    gravity: float
    inertia_roll: float
    inertia_pitch: float
    inertia_yaw: float


@inlined
def load_physics(lanes: Any, lane: int) -> Physics:
    """The parameters in column `lane` of a (9, n) buffer."""
    return Physics(
        lanes[QUADROTOR_MASS, lane],
        lanes[BOB_MASS, lane],
        lanes[ROD_LENGTH, lane],
        lanes[GRAVITY, lane],
        lanes[INERTIA_ROLL, lane],
        lanes[INERTIA_PITCH, lane],
        lanes[INERTIA_YAW, lane],
    )


@inlined
def thrust_axis(euler: Vec3) -> Vec3:
    """R e₃, equation (1)."""
    sin_roll, cos_roll = sincos(euler.x)
    sin_pitch, cos_pitch = sincos(euler.y)
    sin_yaw, cos_yaw = sincos(euler.z)
    return Vec3(
        cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll,
        sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll,
        cos_pitch * cos_roll,
    )


@inlined
def euler_acceleration(torque: Vec3, physics: Physics) -> Vec3:
    """η̈, equation (2); `torque` includes the disturbance."""
    return Vec3(torque.x / physics.inertia_roll, torque.y / physics.inertia_pitch, torque.z / physics.inertia_yaw)


@inlined
def unconstrained_acceleration(force: Vec3, bob_force: Vec3, physics: Physics) -> Vec3:
    """w = (d_B/m_c − F/M) / l, the acceleration that equation (3) projects; `force` is F."""
    of_bob = 1.0 / (physics.bob_mass * physics.rod_length)
    of_quadrotor = -1.0 / (physics.quadrotor_mass * physics.rod_length)
    return axpy(of_bob, bob_force, scale(of_quadrotor, force))


@inlined
def direction_acceleration(r: Vec3, r_dot: Vec3, pull: Vec3) -> Vec3:
    """r̈, equation (3)."""
    return axpy(-(dot(r, pull) + dot(r_dot, r_dot)), r, pull)


@inlined
def centre_acceleration(force: Vec3, bob_force: Vec3, physics: Physics) -> Vec3:
    """Ẍ, equation (4); `force` is F."""
    per_mass = 1.0 / (physics.quadrotor_mass + physics.bob_mass)
    return Vec3(
        per_mass * (force.x + bob_force.x),
        per_mass * (force.y + bob_force.y),
        per_mass * (force.z + bob_force.z) - physics.gravity,
    )


@inlined
def centre_offset(physics: Physics) -> float:
    """μ = m_c l / (M + m_c), m: the centre of mass is at ζ + μ r."""
    return physics.bob_mass * physics.rod_length / (physics.quadrotor_mass + physics.bob_mass)


@compiled
def _accelerations(state: Floats, command: Floats, disturbance: Floats, parameters: Floats, out: Floats) -> None:
    for row in range(state.shape[1]):
        physics = load_physics(parameters, row)
        torque = axpy(1.0, load(disturbance, TORQUE, row), load(command, COMMAND_TORQUE, row))
        force = axpy(command[THRUST, row], thrust_axis(load(state, EULER, row)), load(disturbance, FORCE, row))
        bob_force = load(disturbance, BOB_FORCE, row)
        pull = unconstrained_acceleration(force, bob_force, physics)
        r_ddot = direction_acceleration(load(state, DIRECTION, row), load(state, DIRECTION_RATE, row), pull)
        position_ddot = axpy(-centre_offset(physics), r_ddot, centre_acceleration(force, bob_force, physics))
        euler_ddot = euler_acceleration(torque, physics)
        for i in range(3):
            out[i, row] = position_ddot[i]
            out[3 + i, row] = euler_ddot[i]
            out[6 + i, row] = r_ddot[i]


@dataclass(frozen=True)
class Accelerations:
    """Second derivatives, world frame: ζ̈ (m/s²), η̈ (rad/s²), r̈ (1/s²), each of shape (..., 3)."""

    position: Floats
    euler: Floats
    direction: Floats


def accelerations(state: Floats, command: Floats, disturbance: Floats, parameters: Parameters) -> Accelerations:
    """Second derivatives of the state, equations (1)–(5).

    Args:
        state: shape (..., 18), laid out as in `quadpend_gym.physics.state`.
        command: thrust u (N) and torques τφ, τθ, τψ (N·m), shape (..., 4).
        disturbance: d_Q (N), d_B (N), d_τ (N·m), shape (..., 9).
        parameters: the physical parameters.
    """
    shape = np.broadcast_shapes(state.shape[:-1], command.shape[:-1], disturbance.shape[:-1])

    def columns(array: Floats) -> Floats:
        full = np.broadcast_to(array, (*shape, array.shape[-1]))
        return np.ascontiguousarray(full.reshape(-1, array.shape[-1]).T, dtype=np.float64)

    out = np.empty((9, int(np.prod(shape))))
    physics = np.broadcast_to(parameters.as_array(), (*shape, PARAMETERS_SIZE))
    _accelerations(columns(state), columns(command), columns(disturbance), columns(physics), out)
    rows = np.ascontiguousarray(out.T).reshape(*shape, 9)
    return Accelerations(rows[..., 0:3], rows[..., 3:6], rows[..., 6:9])


def energy(state: Floats, parameters: Parameters) -> Floats:
    """Kinetic plus potential energy, equations (2)–(5) of the paper, J, shape (...)."""
    s, p = State(state), parameters
    bob_velocity = s.velocity + p.rod_length * s.direction_rate
    inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
    kinetic = (
        p.quadrotor_mass * np.sum(s.velocity**2, -1)
        + p.bob_mass * np.sum(bob_velocity**2, -1)
        + np.sum(inertia * s.euler_rate**2, -1)
    ) / 2
    bob_height = s.position[..., 2] + p.rod_length * s.direction[..., 2]
    return np.asarray(kinetic + p.gravity * (p.quadrotor_mass * s.position[..., 2] + p.bob_mass * bob_height))


def momentum(state: Floats, parameters: Parameters) -> Floats:
    """Linear momentum of quadrotor and bob in the world frame, kg·m/s, shape (..., 3)."""
    s, p = State(state), parameters
    return np.asarray(p.total_mass * s.velocity + p.bob_mass * p.rod_length * s.direction_rate)
