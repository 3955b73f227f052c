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

from dataclasses import dataclass

import numpy as np

from quadpend_baselines.estimation.prediction import Estimate, Measurement
from quadpend_baselines.gains import FlatnessGains
from quadpend_baselines.modelling import flat_outputs, taylor
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.planar import limit_norm
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import Disturbance, State

_MIN_THRUST = 0.2  # share of the weight: without thrust, the torques have no effect on the pendulum
_MIN_AXIS_HEIGHT = 0.1  # lower bound of b_z: 84° of tilt; the default limit of an episode is 80°
_MIN_THRUST_EFFECT = 0.1  # lower bound of the factor of u in the equation of the height
_NOMINAL_SCALE: Floats = np.ones((1, 4))


@dataclass(frozen=True)
class Flatness:
    """The control law (1)–(7)."""

    gains: FlatnessGains
    simulation: Simulation

    def initial_memory(self, rows: int) -> tuple[()]:
        """Return an empty tuple: this law has no memory."""
        return ()

    def command(
        self,
        estimate: Estimate,
        measurement: Measurement,
        memory: tuple[()],
        bandwidth_scale: Floats = _NOMINAL_SCALE,
    ) -> tuple[Floats, tuple[()]]:
        """Return the command of equations (1)–(7); see `output_feedback.ControlLaw`.

        `bandwidth_scale` are factors on the bandwidths of position, pendulum, attitude, and of height and yaw together,
        shape (n, 4) or (1, 4).
        """
        model, gains, s = equivalent_model(self.simulation), self.gains, State(estimate.state)
        p, acting = model.parameters, model.disturbance(estimate.disturbance)
        disturbance = Disturbance(acting)
        vertical_bandwidth = gains.vertical_bandwidth * bandwidth_scale[:, 3]
        desired = flat_outputs.flat_trajectory(model.reference(measurement.reference), acting, p)
        tangent = flat_outputs.tangent_from_attitude(taylor.from_derivatives(s.euler, s.euler_rate))
        axis_height = np.maximum(np.cos(s.euler[:, 0]) * np.cos(s.euler[:, 1]), _MIN_AXIS_HEIGHT)
        thrust = self._thrust(s, disturbance, measurement, tangent[0], axis_height, vertical_bandwidth)
        r_z = s.direction[:, 2:]
        pole = s.direction[:, :2] / r_z
        pole_rate = (s.direction_rate[:, :2] - pole * s.direction_rate[:, 2:]) / r_z
        pendulum = model.sigma(pole, tangent[0])
        pendulum_rate = model.sigma(pole_rate, tangent[1])
        bob_gravity = (p.gravity + measurement.reference[:, 0, 2] - disturbance.bob_force[:, 2] / p.bob_mass)[
            :, np.newaxis
        ]
        per_rod = 1.0 / (r_z * p.quadrotor_mass * p.rod_length)
        stiffness = per_rod * (thrust * axis_height)[:, np.newaxis]
        relative = p.quadrotor_mass / p.bob_mass * disturbance.bob_force - disturbance.force
        drift = per_rod * (relative[:, :2] - pendulum * relative[:, 2:])
        drift -= 2.0 * pendulum_rate * s.direction_rate[:, 2:] / r_z
        s_d, t_d = taylor.to_derivatives(desired.pendulum_tangent), taylor.to_derivatives(desired.thrust_tangent)

        length = self.simulation.parameters.rod_length
        e0 = s.position[:, :2] + length * s.direction[:, :2]
        e1 = s.velocity[:, :2] + length * s.direction_rate[:, :2]
        poles_d = model.pendulum(s_d[:2], t_d[:2])
        e0 += model.pendulum_arm * (pole - poles_d[0]) + model.thrust_arm * (tangent[0] - t_d[0])
        e1 += model.pendulum_arm * (pole_rate - poles_d[1]) + model.thrust_arm * (tangent[1] - t_d[1])
        e2, e3 = bob_gravity * (pendulum - s_d[0]), bob_gravity * (pendulum_rate - s_d[1])
        s2 = stiffness * (pendulum - tangent[0]) + drift
        e4 = bob_gravity * (s2 - s_d[2])
        total_stiffness = stiffness - per_rod * relative[:, 2:]  # κ' = ∂s̈/∂s
        e5 = bob_gravity * (total_stiffness * (pendulum_rate - s_d[1]) - stiffness * (tangent[1] - t_d[1]))

        far = (gains.position_bandwidth, gains.far_pendulum_bandwidth, gains.far_attitude_bandwidth)
        near = (gains.position_bandwidth, gains.pendulum_bandwidth, gains.attitude_bandwidth)
        mode = np.linalg.norm(e2 + e3 / np.sqrt(np.abs(stiffness)), axis=1) / bob_gravity[:, 0]
        share = 1.0 / (1.0 + (mode / gains.near) ** 2)
        bandwidths = [f * (a + (b - a) * share) for a, b, f in zip(far, near, bandwidth_scale.T, strict=False)]
        k = _coefficients(bandwidths, gains.damping)
        velocity = limit_norm(k[0] / k[1] * e0, gains.velocity)
        e2_demanded = -limit_norm(k[1] / k[2] * (e1 + velocity), gains.acceleration)
        e4_demanded = -(k[3] * e3 + k[2] * (e2 - e2_demanded)) / k[4]
        tangent_demanded = pendulum - (s_d[2] + e4_demanded / bob_gravity - drift) / stiffness
        tangent_demanded = limit_norm(tangent_demanded, np.tan(gains.lean))
        e4_demanded = bob_gravity * (stiffness * (pendulum - tangent_demanded) + drift - s_d[2])
        e6 = -k[5] * e5 - k[4] * (e4 - e4_demanded)
        t2 = t_d[2] + total_stiffness / stiffness * (s2 - s_d[2]) - e6 / (bob_gravity * stiffness)

        yaw_acceleration = self._yaw_acceleration(s, measurement, vertical_bandwidth)
        yaw = taylor.from_derivatives(s.euler[:, 2], s.euler_rate[:, 2], yaw_acceleration)
        attitude = flat_outputs.attitude_from_tangent(np.stack([*tangent, 0.5 * t2]), yaw)
        inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
        torque = inertia * taylor.to_derivatives(attitude)[2] - disturbance.torque
        command = np.column_stack([thrust, torque])
        return model.body_command(estimate.state, command, estimate.disturbance), memory

    def _yaw_acceleration(self, s: State, measurement: Measurement, w: Floats) -> Floats:
        """Return the demanded ψ̈ for the bandwidth w, rad/s², shape (n,)."""
        reference, reference_rate, reference_acceleration = measurement.yaw_reference.T
        error, rate = s.euler[:, 2] - reference, s.euler_rate[:, 2] - reference_rate
        return np.asarray(reference_acceleration - 2.0 * self.gains.damping * w * rate - w * w * error)

    def _thrust(
        self, s: State, d: Disturbance, measurement: Measurement, tangent: Floats, axis_height: Floats, w: Floats
    ) -> Floats:
        """Return the thrust of equation (6), N, shape (n,), from t, b_z and the bandwidth w."""
        p = equivalent_model(self.simulation).parameters
        feedback = 2.0 * self.gains.damping * w * s.velocity[:, 2], w * w * s.position[:, 2]
        acceleration = measurement.reference[:, 0, 2] - feedback[0] - feedback[1]
        axis = np.column_stack([tangent, np.ones_like(axis_height)]) * axis_height[:, np.newaxis]
        # r̈_z is the sum of a part without thrust and a part proportional to the thrust.
        relative = (d.bob_force / p.bob_mass - d.force / p.quadrotor_mass) / p.rod_length
        r, r_z = s.direction, s.direction[:, 2]
        without_thrust = relative[:, 2] - (np.sum(r * relative, axis=1) + np.sum(s.direction_rate**2, axis=1)) * r_z
        force = p.total_mass * (p.gravity + acceleration) - d.force[:, 2] - d.bob_force[:, 2]
        effect = axis_height + p.bob_mass / p.quadrotor_mass * (axis_height - np.sum(r * axis, axis=1) * r_z)
        thrust = (force + p.bob_mass * p.rod_length * without_thrust) / np.maximum(effect, _MIN_THRUST_EFFECT)
        return np.asarray(np.clip(thrust, _MIN_THRUST * p.hover_thrust, 2.0 * p.hover_thrust))


def _coefficients(bandwidths: list[Floats], damping: float) -> list[Floats]:
    """Return k₀ … k₅ of Π (s² + 2ζω s + ω²), each of shape (n, 1), from the bandwidths ω, each of shape (n,)."""
    polynomial = [np.ones_like(bandwidths[0])]
    for w in bandwidths:
        product = [*polynomial, np.zeros_like(w), np.zeros_like(w)]
        for i, c in enumerate(polynomial):
            product[i + 1] = product[i + 1] + 2.0 * damping * w * c
            product[i + 2] = product[i + 2] + w * w * c
        polynomial = product
    return [c[:, np.newaxis] for c in polynomial[:0:-1]]
