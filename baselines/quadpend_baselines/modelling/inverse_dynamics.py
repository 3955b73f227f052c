"""Inverse dynamics of the attitude of rigid vehicles: the torques that make demanded Euler-angle accelerations.

With the body rate ω = E(η) η̇, equation (3) of `quadpend_gym.physics.attitude`, ω̇ = E η̈ + Ė η̇. By the equations of
`quadpend_gym.physics.rigid_body`, ω̇ = ω̇₀ + G τ depends linearly on the torques, and the three columns of G follow from
evaluations with unit torques. So the gyroscopic torque, the force of the pole at its pivot, the angular drag and all
products of inertia are taken into account. The drag of the rotors and the gyroscopics of the propellers are left out.
"""

import numpy as np

from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.attitude import body_rate, quaternion_from_euler
from quadpend_gym.physics.dynamics import load_physics
from quadpend_gym.physics.rigid_body import Loads, Motion, Wrench, derivative, rigid_physics
from quadpend_gym.physics.rigid_settings import pack_rigid, unpack_rigid
from quadpend_gym.physics.state import BOB_FORCE, DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, FORCE, TORQUE
from quadpend_gym.physics.vectors import Vec3, add, axpy, cross, dot, load, scale


@inlined
def _body_rate_acceleration(euler: Vec3, rate: Vec3, acceleration: Vec3) -> Vec3:
    """Return ω̇ = E η̈ + Ė η̇."""
    sin_roll, cos_roll = sincos(euler.x)
    sin_pitch, cos_pitch = sincos(euler.y)
    change = Vec3(
        -rate.z * rate.y * cos_pitch,
        rate.x * (rate.z * cos_roll * cos_pitch - rate.y * sin_roll) - rate.z * rate.y * sin_roll * sin_pitch,
        -rate.x * (rate.y * cos_roll + rate.z * sin_roll * cos_pitch) - rate.z * rate.y * cos_roll * sin_pitch,
    )
    return add(body_rate(euler, acceleration), change)


@compiled
def _body_torques(
    state: Floats,
    acceleration: Floats,
    thrust: Floats,
    disturbance: Floats,
    parameters: Floats,
    packed: Floats,
    out: Floats,
) -> None:
    settings = unpack_rigid(packed)
    physics = load_physics(parameters, 0)
    body = rigid_physics(physics, settings.correlation, settings.pivot, settings.shape)
    states, accelerations, disturbances = state.T, acceleration.T, disturbance.T
    for row in range(state.shape[0]):
        euler, euler_rate = load(states, EULER, row), load(states, EULER_RATE, row)
        wanted = _body_rate_acceleration(euler, euler_rate, load(accelerations, 0, row))
        force, bob_force = load(disturbances, FORCE, row), load(disturbances, BOB_FORCE, row)
        relative = axpy(1.0 / physics.quadrotor_mass, force, scale(-1.0 / physics.bob_mass, bob_force))
        loads = Loads(force, bob_force, relative, load(disturbances, TORQUE, row), 0.0, settings.angular_drag)
        motion = Motion(
            quaternion_from_euler(euler),
            body_rate(euler, euler_rate),
            load(states, DIRECTION, row),
            load(states, DIRECTION_RATE, row),
        )
        u = thrust[row]
        none = derivative(motion, Wrench(u, Vec3(0.0, 0.0, 0.0)), loads, physics, body).motion.rate
        a = axpy(-1.0, none, derivative(motion, Wrench(u, Vec3(1.0, 0.0, 0.0)), loads, physics, body).motion.rate)
        b = axpy(-1.0, none, derivative(motion, Wrench(u, Vec3(0.0, 1.0, 0.0)), loads, physics, body).motion.rate)
        c = axpy(-1.0, none, derivative(motion, Wrench(u, Vec3(0.0, 0.0, 1.0)), loads, physics, body).motion.rate)
        missing = axpy(-1.0, none, wanted)
        volume = dot(a, cross(b, c))  # Cramer's rule
        out[row, 0] = dot(missing, cross(b, c)) / volume
        out[row, 1] = dot(a, cross(missing, c)) / volume
        out[row, 2] = dot(a, cross(b, missing)) / volume


def body_torques(
    state: Floats, acceleration: Floats, thrust: Floats, disturbance: Floats, simulation: Simulation
) -> Floats:
    """Return the torques about the axes of a rigid vehicle's body that make Euler-angle accelerations, N·m, (n, 3).

    Rows have a state, shape (n, 18), φ̈, θ̈, ψ̈ (rad/s²), shape (n, 3), a thrust (N), and d_Q, d_B (N), d_τ (N·m), (n, 9).
    """
    out = np.empty_like(acceleration)
    parameters = simulation.parameters.as_array()[:, np.newaxis]
    thrust = np.ascontiguousarray(thrust)
    _body_torques(state, acceleration, thrust, disturbance, parameters, pack_rigid(simulation), out)
    return out
