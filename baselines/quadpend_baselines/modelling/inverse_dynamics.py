"""Inverse dynamics of the attitude of rigid vehicles: the torques that make demanded Euler-angle accelerations.

With the body rate ω = E(η) η̇, equation (3) of `quadpend_gym.physics.attitude`, ω̇ = E η̈ + Ė η̇. By the equations of
`quadpend_gym.physics.rigid_body`, ω̇ = ω̇₀ + G τ depends linearly on the torques, and the three columns of G follow from
evaluations with unit torques. So the gyroscopic torque, the force of the pole at its pivot, the angular drag and all
products of inertia are taken into account. Other drag counts as far as the given forces contain it; the gyroscopics of
the propellers are left out.
"""

from quadpend_baselines.modelling.quantities import Forces, VehicleState
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.attitude import body_rate, quaternion_from_euler
from quadpend_gym.physics.rigid_body import Loads, Motion, Wrench, derivative, rigid_physics
from quadpend_gym.physics.rigid_settings import RigidSettings
from quadpend_gym.physics.vectors import Vec3, add, axpy, cross, dot, scale
from quadpend_gym.vehicles import Parameters


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


@inlined
def body_torques(
    state: VehicleState, acceleration: Vec3, thrust: float, forces: Forces, physics: Parameters, rigid: RigidSettings
) -> Vec3:
    """Return the torques about the body's axes (N·m) that make the accelerations φ̈, θ̈, ψ̈ of the Euler angles."""
    body = rigid_physics(physics, rigid.correlation, rigid.pivot, rigid.shape)
    force, bob_force, euler, rate = forces.force, forces.bob_force, state.euler, state.euler_rate
    relative = axpy(1.0 / physics.quadrotor_mass, force, scale(-1.0 / physics.bob_mass, bob_force))
    loads = Loads(force, bob_force, relative, forces.torque, 0.0, rigid.angular_drag)
    motion = Motion(quaternion_from_euler(euler), body_rate(euler, rate), state.direction, state.direction_rate)
    none = derivative(motion, Wrench(thrust, Vec3(0.0, 0.0, 0.0)), loads, physics, body).motion.rate
    # Columns of G
    a = axpy(-1.0, none, derivative(motion, Wrench(thrust, Vec3(1.0, 0.0, 0.0)), loads, physics, body).motion.rate)
    b = axpy(-1.0, none, derivative(motion, Wrench(thrust, Vec3(0.0, 1.0, 0.0)), loads, physics, body).motion.rate)
    c = axpy(-1.0, none, derivative(motion, Wrench(thrust, Vec3(0.0, 0.0, 1.0)), loads, physics, body).motion.rate)
    missing = axpy(-1.0, none, _body_rate_acceleration(euler, rate, acceleration))
    volume = dot(a, cross(b, c))  # Cramer's rule
    return Vec3(
        dot(missing, cross(b, c)) / volume, dot(a, cross(missing, c)) / volume, dot(a, cross(b, missing)) / volume
    )
