"""Equations of motion on R³ × R³ × S².

They need no matrix inverse and have no singularity; the paper's equations are singular when the pendulum is upright.
With the force on the quadrotor F = u R e₃ + d_Q, the force on the bob d_B, the torque d_τ, and the acceleration
w = (d_B/m_c − F/M) / l that r would have without the force of the rod:

    (1)  R e₃ = (cψ sθ cφ + sψ sφ,  sψ sθ cφ − cψ sφ,  cθ cφ)       thrust axis
    (2)  η̈    = I⁻¹ (τ + d_τ)                                       attitude
    (3)  r̈    = w − (r·w + ṙ·ṙ) r                                   pendulum
    (4)  Ẍ    = (F + d_B) / (M + m_c) − g e₃                        centre of mass X = ζ + μ r,  μ = m_c l/(M + m_c)
    (5)  ζ̈    = Ẍ − μ r̈                                             quadrotor

In (3) the projection onto the plane perpendicular to r removes the force of the rod. In (4) that force cancels, because
it is internal. The equations are equivalent to the paper's Euler–Lagrange equations (7). Two tests show this:
``tests/quadpend_gym/physics/test_lagrangian.py`` compares them with a Lagrangian that sympy differentiates, and
``tests/quadpend_gym/physics/test_mujoco.py`` compares all but (2) with a rigid-body engine. Equation (2) is the paper's
attitude model: a constant inertia multiplies the Euler-angle rates, and gyroscopic coupling is neglected.

| symbol   | code name                               | unit | frame        | shape  |
|----------|-----------------------------------------|------|--------------|--------|
| u        | command[THRUST]                         | N    | along R e₃   | scalar |
| τ        | command[COMMAND_TORQUE]                 | N·m  | φ, θ, ψ axes | 3      |
| d_Q, d_B | disturbance[FORCE], [BOB_FORCE]         | N    | world        | 3, 3   |
| d_τ      | disturbance[TORQUE]                     | N·m  | φ, θ, ψ axes | 3      |
| F        | force                                   | N    | world        | 3      |
| w        | `unconstrained_acceleration`            | 1/s² | world        | 3      |
| μ        | `centre_offset`                         | m    |              | scalar |

`quadpend_gym.physics.state` lists the symbols of the state, `quadpend_gym.vehicles.parameters` those of the parameters.
"""

from typing import Any

from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.vectors import Vec3, axpy, dot, load, scale
from quadpend_gym.vehicles import Parameters


@inlined
def load_physics(lanes: Any, lane: int) -> Parameters:
    """Return the parameters in column `lane` of a (9, n) buffer."""
    masses, moments, drag = load(lanes, 0, lane), load(lanes, 4, lane), load(lanes, 6, lane)
    return Parameters(masses.x, masses.y, masses.z, lanes[3, lane], moments.x, moments.y, moments.z, drag.y, drag.z)


@inlined
def thrust_axis(euler: Vec3) -> Vec3:
    """Return the thrust axis R e₃, equation (1)."""
    sin_roll, cos_roll = sincos(euler.x)
    sin_pitch, cos_pitch = sincos(euler.y)
    sin_yaw, cos_yaw = sincos(euler.z)
    return Vec3(
        cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll,
        sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll,
        cos_pitch * cos_roll,
    )


@inlined
def euler_acceleration(torque: Vec3, physics: Parameters) -> Vec3:
    """Return η̈, equation (2); `torque` is τ + d_τ."""
    return Vec3(torque.x / physics.inertia_roll, torque.y / physics.inertia_pitch, torque.z / physics.inertia_yaw)


@inlined
def unconstrained_acceleration(force: Vec3, bob_force: Vec3, physics: Parameters) -> Vec3:
    """Return w = (d_B/m_c − F/M) / l, the acceleration of r without the force of the rod; `force` is F."""
    per_bob_force = 1.0 / (physics.bob_mass * physics.rod_length)
    per_force = -1.0 / (physics.quadrotor_mass * physics.rod_length)
    return axpy(per_bob_force, bob_force, scale(per_force, force))


@inlined
def direction_acceleration(r: Vec3, r_dot: Vec3, w: Vec3) -> Vec3:
    """Return r̈, equation (3)."""
    return axpy(-(dot(r, w) + dot(r_dot, r_dot)), r, w)


@inlined
def centre_acceleration(force: Vec3, bob_force: Vec3, physics: Parameters) -> Vec3:
    """Return Ẍ, equation (4); `force` is F."""
    per_mass = 1.0 / (physics.quadrotor_mass + physics.bob_mass)
    return Vec3(
        per_mass * (force.x + bob_force.x),
        per_mass * (force.y + bob_force.y),
        per_mass * (force.z + bob_force.z) - physics.gravity,
    )


@inlined
def centre_offset(physics: Parameters) -> float:
    """Return μ = m_c l / (M + m_c) in m; the centre of mass is at ζ + μ r."""
    return physics.bob_mass * physics.rod_length / (physics.quadrotor_mass + physics.bob_mass)
