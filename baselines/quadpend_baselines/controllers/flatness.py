"""Flatness-based cascade of position, pendulum direction, thrust direction and attitude, valid at tilts below 90°.

The symbols are those of `flat_outputs`. The subscript d denotes the trajectory that follows the reference under the
estimated disturbance. The errors of the bob's horizontal position and of its first five derivatives are

    (1)  e = F − F_d, ė,   e₂ = G (s − s_d),   e₃ = G (ṡ − ṡ_d),   e₄ = G (s̈ − s̈_d),
         e₅ = G (κ' (ṡ − ṡ_d) − κ (ṫ − ṫ_d)),                   κ' = ∂s̈/∂s = κ + (d_Qz − M/m_c d_Bz)/(r_z M l)

With the coefficients k₀ … k₅ of the polynomial of three pairs of poles, the cascade is

    (2)  e₂* = −sat(k₁/k₂ (ė + sat(k₀/k₁ e)))           bob acceleration that the position error demands
    (3)  e₄* = −(k₃ e₃ + k₂ (e₂ − e₂*))/k₄              tilt of the thrust that the pendulum demands, limited
    (4)  e₆  = −k₅ e₅ − k₄ (e₄ − e₄*)                   angular acceleration that the thrust direction demands
    (5)  ẗ   = ẗ_d + κ'/κ (s̈ − s̈_d) − e₆/(G κ)

If no limit is active and the rates of κ and G are neglected, these equations give e₆ = −Σ k_i e_i. The thrust follows
from the exact equation of the height:

    (6)  z̈ = z̈_d − 2ζω ė_z − ω² e_z,     u = ((M + m_c)(g + z̈) + m_c l r̈_z − d_Qz − d_Bz)/b_z

where r̈_z depends on u. The bandwidths are scheduled: fast poles reject wind near the desired pendulum direction, and
slow poles avoid torque saturation far from it. The scheduling variable is the unstable mode of the pendulum:

    (7)  η = |e₂ + e₃/√κ| / G,     ω = ω_far + (ω_near − ω_far)/(1 + (η/η₀)²)

For rigid vehicles, F, s and the parameters are those of the equivalent pendulum (`modelling.equivalent`, where σ is
called s here), and the torques that make the demanded accelerations follow from the inverse dynamics.
"""

from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from quadpend_baselines.controllers.law import Law
from quadpend_baselines.estimation.estimate import Estimate, law_inputs
from quadpend_baselines.gains import Angle, Bandwidth, Damping, EstimatorGains, Positive, Scale
from quadpend_baselines.modelling.equivalent import (
    Pendulum,
    body_command,
    chain_stiffness,
    equivalent_forces,
    equivalent_model,
    equivalent_reference,
    flat_output,
    pendulum_of,
    sigma_of,
    unpack_pendulum,
)
from quadpend_baselines.modelling.flat_outputs import (
    coefficients,
    euler_accelerations,
    flat_trajectory,
    tangent_from_attitude,
)
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    bob_offset,
    divide,
    limit_length,
    minus,
)
from quadpend_baselines.modelling.trajectory_drag import forces_now, plus_constant, trajectory_drag
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.core.settings import settings
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.vectors import Four, Vec3, add, axpy, dot, scale, store_four
from quadpend_gym.vehicles import Parameters

_MIN_THRUST = 0.2  # share of the weight: without thrust, the torques have no effect on the pendulum
_MIN_AXIS_HEIGHT = 0.1  # lower bound of b_z: 84° of tilt; the default limit of an episode is 80°
_MIN_THRUST_EFFECT = 0.1  # lower bound of the factor of u in the equation of the height


@settings
class FlatnessGains:
    """Gains of `controllers.flatness`."""

    position_bandwidth: Bandwidth = 2.5  # of a pair of poles
    pendulum_bandwidth: Bandwidth = 7.0  # near the desired pendulum direction
    attitude_bandwidth: Bandwidth = 20.0  # near the desired pendulum direction
    damping: Damping = 0.9  # ζ of all pairs of poles
    vertical_bandwidth: Bandwidth = 6.0  # of height and yaw
    acceleration: Positive = 3.0  # m/s², limit of the bob acceleration that the position error demands
    velocity: Annotated[Positive, Scale(-1)] = 1.5  # m/s, limit of the velocity that the position error demands
    lean: Angle = 1.1  # limit of the tilt of the thrust
    far_pendulum_bandwidth: Bandwidth = 4.5  # far from the desired pendulum direction
    far_attitude_bandwidth: Bandwidth = 8.0  # far from the desired pendulum direction
    near: Positive = 0.1  # η₀: at η = η₀ each bandwidth is the mean of its near and far values
    estimator: EstimatorGains = EstimatorGains()


unpack_gains = unpacker(FlatnessGains)


@inlined
def flatness(
    s: VehicleState,
    disturbance: Forces,
    reference: Derivatives,
    gains: FlatnessGains,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> Four:
    """Return thrust (N) and torques (N·m) of equations (1)–(7)."""
    p, r, r_dot = model.physics, s.direction, s.direction_rate
    drag = trajectory_drag(reference, model.vehicle, chain_stiffness(p))
    acting = plus_constant(drag, disturbance)
    forces = equivalent_forces(acting, model)
    path, d = flat_trajectory(equivalent_reference(reference, drag, model), forces, p), forces_now(forces, disturbance)
    t0, t1, _ = coefficients(tangent_from_attitude(s.euler, s.euler_rate))
    axis_height = max(sincos(s.euler.x)[1] * sincos(s.euler.y)[1], _MIN_AXIS_HEIGHT)
    demanded = reference.d2.z - _feedback(s.velocity.z, s.position.z, gains.damping, gains.vertical_bandwidth)
    thrust = _thrust(s, d, demanded, Vec3(t0.x * axis_height, t0.y * axis_height, axis_height), p)
    pole = divide(r, r.z)
    pole_rate = divide(axpy(-r_dot.z, pole, r_dot), r.z)
    s0, s1 = sigma_of(pole, t0, model), sigma_of(pole_rate, t1, model)
    gravity = p.gravity + reference.d2.z - d.bob_force.z / p.bob_mass  # G
    per_rod = 1.0 / (r.z * p.quadrotor_mass * p.rod_length)
    stiffness = per_rod * (thrust * axis_height)  # κ
    relative = axpy(p.quadrotor_mass / p.bob_mass, d.bob_force, scale(-1.0, d.force))
    ratio = (stiffness - per_rod * relative.z) / stiffness  # κ'/κ
    closing = 2.0 * r_dot.z / r.z
    drift = axpy(-closing, s1, scale(per_rod, axpy(-relative.z, s0, relative)))
    s2 = axpy(stiffness, minus(s0, t0), drift)
    s0_d, s1_d, s2_d = coefficients(path.pendulum)
    t0_d, t1_d, t2_d = coefficients(path.tangent)
    s2_d, t2_d = scale(2.0, s2_d), scale(2.0, t2_d)

    # (1): errors of the flat output and of its derivatives
    bob, bob_rate = bob_offset(s, model.vehicle.rod_length)
    e0 = flat_output(bob, minus(pole, pendulum_of(s0_d, t0_d, model)), minus(t0, t0_d), model)
    e1 = flat_output(bob_rate, minus(pole_rate, pendulum_of(s1_d, t1_d, model)), minus(t1, t1_d), model)
    e2, e3 = scale(gravity, minus(s0, s0_d)), scale(gravity, minus(s1, s1_d))
    # (7): bandwidths by the unstable mode of the pendulum
    mode = divide(axpy(1.0 / np.sqrt(abs(stiffness)), e3, e2), gravity)
    share = 1.0 / (1.0 + (mode.x * mode.x + mode.y * mode.y) / (gains.near * gains.near))
    far, near = gains.far_pendulum_bandwidth, gains.pendulum_bandwidth
    pendulum_bandwidth = far + (near - far) * share
    far, near = gains.far_attitude_bandwidth, gains.attitude_bandwidth
    attitude_bandwidth = far + (near - far) * share
    k = _coefficients(gains.position_bandwidth, pendulum_bandwidth, attitude_bandwidth, gains.damping)
    # (2) and (3): the acceleration and the tilt of the thrust that the errors demand, limited
    velocity = limit_length(scale(k[0] / k[1], e0), gains.velocity)
    wanted = limit_length(scale(k[1] / k[2], add(e1, velocity)), gains.acceleration)
    e4 = divide(axpy(-k[3], e3, scale(-k[2], add(e2, wanted))), k[4])
    sine, cosine = sincos(gains.lean)
    tilt = minus(s0, divide(minus(add(s2_d, divide(e4, gravity)), drift), stiffness))
    tilt = limit_length(tilt, sine / cosine)
    # (4) and (5): e₄ − e₄* is that of the limited tilt, in which all but the tangents cancel
    t2 = axpy(ratio, minus(s2, s2_d), t2_d)
    damped = minus(scale(ratio, minus(s1, s1_d)), minus(t1, t1_d))
    t2 = add(t2, axpy(k[5], damped, scale(k[4], minus(tilt, t0))))

    yaw = reference.yaw
    yaw_error, yaw_rate = s.euler.z - yaw.x, s.euler_rate.z - yaw.y
    yaw_acceleration = yaw.z - _feedback(yaw_rate, yaw_error, gains.damping, gains.vertical_bandwidth)
    turning = euler_accelerations(t0, t1, t2, Vec3(s.euler.z, s.euler_rate.z, yaw_acceleration))
    command = Four(
        thrust,
        p.inertia_roll * turning.x - d.torque.x,
        p.inertia_pitch * turning.y - d.torque.y,
        p.inertia_yaw * yaw_acceleration - d.torque.z,
    )
    return body_command(s, command, forces_now(acting, disturbance), model, rigid)


@inlined
def _feedback(rate: float, error: float, damping: float, bandwidth: float) -> float:
    """Return 2ζω ė + ω² e."""
    return 2.0 * damping * bandwidth * rate + bandwidth * bandwidth * error


@inlined
def _thrust(s: VehicleState, d: Forces, acceleration: float, axis: Vec3, p: Parameters) -> float:
    """Return the thrust of equation (6), N, from z̈ and the thrust axis b."""
    # r̈_z is the sum of a part without thrust and a part proportional to the thrust.
    relative = axpy(1.0 / p.bob_mass, d.bob_force, scale(-1.0 / p.quadrotor_mass, d.force))
    r, r_dot = s.direction, s.direction_rate
    along = dot(r, relative) / p.rod_length + dot(r_dot, r_dot)
    without_thrust = relative.z / p.rod_length - along * r.z
    total = p.quadrotor_mass + p.bob_mass
    force = total * (p.gravity + acceleration) - d.force.z - d.bob_force.z + p.bob_mass * p.rod_length * without_thrust
    effect = axis.z + p.bob_mass / p.quadrotor_mass * (axis.z - dot(r, axis) * r.z)
    weight = total * p.gravity
    return min(max(force / max(effect, _MIN_THRUST_EFFECT), _MIN_THRUST * weight), 2.0 * weight)


@inlined
def _coefficients(a: float, b: float, c: float, damping: float) -> tuple[float, float, float, float, float, float]:
    """Return k₀ … k₅ of Π (s² + 2ζω s + ω²) for three bandwidths ω."""
    twice = 2.0 * damping
    p0, p1 = a * a * b * b, twice * a * b * (a + b)  # of the first two pairs: s⁴ + p₃ s³ + p₂ s² + p₁ s + p₀
    p2, p3 = a * a + b * b + twice * twice * a * b, twice * (a + b)
    q0, q1 = c * c, twice * c
    return p0 * q0, p1 * q0 + p0 * q1, p2 * q0 + p1 * q1 + p0, p3 * q0 + p2 * q1 + p1, q0 + p3 * q1 + p2, q1 + p3


@compiled
def _commands(estimate: Floats, packed: Any, packed_rigid: Floats | None, out: Floats) -> None:
    numbers, pendulum = unpack_gains(packed[0]), unpack_pendulum(packed[1])
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(out.shape[0]):
        state, forces, wanted = law_inputs(estimate, row)
        store_four(out.T, 0, row, flatness(state, forces, wanted, numbers, pendulum, rigid))


@dataclass(frozen=True)
class Flatness(Law):
    """The control law (1)–(7) for n rows."""

    gains: FlatnessGains
    flies_load = True

    @cached_property
    def _numbers(self) -> tuple[Any, Floats | None]:
        model = equivalent_model(self.simulation)
        return (pack(astuple(self.gains)), model.packed), model.packed_rigid

    def command(self, estimate: Estimate, memory: tuple[()]) -> tuple[Floats, tuple[()]]:
        """Return the command of equations (1)–(7); see `law.Law`."""
        out = np.empty((len(estimate.array), 4))
        _commands(estimate.array, *self._numbers, out)
        return out, memory
