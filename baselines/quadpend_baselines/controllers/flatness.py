"""A flatness-based controller: pendulum direction, then thrust direction, then attitude, in coordinates for any tilt.

With the symbols of `flat_outputs`, what is measured against what the reference and the estimated wind ask for (d):

    (1)  e = F − F_d, ė,   e₂ = G (s − s_d),   e₃ = G (ṡ − ṡ_d),   e₄ = G (s̈ − s̈_d),
         e₅ = G (κ' (ṡ − ṡ_d) − κ (ṫ − ṫ_d)),                   κ' = ∂s̈/∂s = κ + (d_Qz − M/m_c d_Bz)/(r_z M l)

are the bob's errors of order 0 … 5, and with k_i the coefficients of three pairs of poles the cascade is

    (2)  e₂* = −sat(k₁/k₂ (ė + sat(k₀/k₁ e)))           what the position asks of the bob's acceleration
    (3)  e₄* = −(k₃ e₃ + k₂ (e₂ − e₂*))/k₄              and that of the thrust's lean, which is bounded
    (4)  e₆  = −k₅ e₅ − k₄ (e₄ − e₄*)                   and that of the torque
    (5)  ẗ   = ẗ_d + κ'/κ (s̈ − s̈_d) − e₆/(G κ)

which between the bounds is e₆ = −Σ k_i e_i, but for the rates of κ and G. The thrust follows from the height's
equation, exact as well:

    (6)  z̈ = z̈_d − 2ζω ė_z − ω² e_z,     u = ((M + m_c)(g + z̈) + m_c l r̈_z − d_Qz − d_Bz)/b_z

in which r̈_z has its own part of u. The poles are slower the farther the pendulum is from where it should be: fast ones
track in the wind, and slow ones do not run into the torque's limit. The measure is the pendulum's unstable mode

    (7)  η = |e₂ + e₃/√κ| / G,     ω = ω_far + (ω_near − ω_far)/(1 + (η/η₀)²)
"""

from dataclasses import dataclass

import numpy as np

from quadpend_baselines.estimation.estimator import Estimate, Measurement
from quadpend_baselines.gains import FlatnessGains
from quadpend_baselines.modelling import flat_outputs, taylor
from quadpend_baselines.modelling.planar import limit_norm
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State

_LEAST_THRUST = 0.2  # of the weight: without thrust there is no torque on the pendulum
_NOMINAL: Floats = np.ones((1, 4))
_LEAST_HEIGHT = 0.1  # of b_z, beyond 84° of tilt, where no episode is


@dataclass(frozen=True)
class Flatness:
    """The law (1)–(7)."""

    gains: FlatnessGains
    simulation: Simulation

    def initial_memory(self, rows: int) -> tuple[()]:
        """Nothing is remembered."""
        return ()

    def command(
        self, estimate: Estimate, measurement: Measurement, memory: tuple[()], bandwidth_scale: Floats = _NOMINAL
    ) -> tuple[Floats, tuple[()]]:
        """Equations (1)–(7); see `observed.ControlLaw`.

        Args:
            estimate: of state and wind.
            measurement: of the reference.
            memory: none.
            bandwidth_scale: factors on the bandwidths of position, pendulum, attitude, and of height and yaw, shape (n, 4).
        """
        p, gains, s = self.simulation.parameters, self.gains, State(estimate.state)
        vertical = gains.vertical_bandwidth * bandwidth_scale[:, 3]
        wanted = flat_outputs.flat_trajectory(measurement.reference, estimate.disturbance, p)
        lean = flat_outputs.tangent_from_attitude(taylor.from_derivatives(s.euler, s.euler_rate))
        axis_height = np.maximum(np.cos(s.euler[:, 0]) * np.cos(s.euler[:, 1]), _LEAST_HEIGHT)
        thrust = self._thrust(estimate, measurement, lean[0], axis_height, vertical)
        upright = s.direction[:, 2:]
        pendulum = s.direction[:, :2] / upright
        swing = (s.direction_rate[:, :2] - pendulum * s.direction_rate[:, 2:]) / upright
        on_quadrotor, on_bob = estimate.disturbance[:, 0:3], estimate.disturbance[:, 3:6]
        weight = (p.gravity + measurement.reference[:, 0, 2] - on_bob[:, 2] / p.bob_mass)[:, np.newaxis]
        per_rod = 1.0 / (upright * p.quadrotor_mass * p.rod_length)
        steepness = per_rod * (thrust * axis_height)[:, np.newaxis]
        relative = p.quadrotor_mass / p.bob_mass * on_bob - on_quadrotor
        drift = per_rod * (relative[:, :2] - pendulum * relative[:, 2:])
        drift -= 2.0 * swing * s.direction_rate[:, 2:] / upright
        s_d, t_d = taylor.to_derivatives(wanted.pendulum), taylor.to_derivatives(wanted.lean)

        e0 = s.position[:, :2] + p.rod_length * s.direction[:, :2]
        e1 = s.velocity[:, :2] + p.rod_length * s.direction_rate[:, :2]
        e2, e3 = weight * (pendulum - s_d[0]), weight * (swing - s_d[1])
        s2 = steepness * (pendulum - lean[0]) + drift
        e4 = weight * (s2 - s_d[2])
        stiffness = steepness - per_rod * relative[:, 2:]  # ∂s̈/∂s, with what of δ goes with s
        e5 = weight * (stiffness * (swing - s_d[1]) - steepness * (lean[1] - t_d[1]))

        far = (gains.position_bandwidth, gains.far_pendulum_bandwidth, gains.far_attitude_bandwidth)
        near = (gains.position_bandwidth, gains.pendulum_bandwidth, gains.attitude_bandwidth)
        mode = np.linalg.norm(e2 + e3 / np.sqrt(steepness), axis=1) / weight[:, 0]
        share = 1.0 / (1.0 + (mode / gains.near) ** 2)
        poles = [f * (a + (b - a) * share) for a, b, f in zip(far, near, bandwidth_scale.T, strict=False)]
        k = _coefficients(poles, gains.damping)
        pace = limit_norm(k[0] / k[1] * e0, gains.velocity)
        asked = -limit_norm(k[1] / k[2] * (e1 + pace), gains.acceleration)
        e4_asked = -(k[3] * e3 + k[2] * (e2 - asked)) / k[4]
        lean_asked = pendulum - (s_d[2] + e4_asked / weight - drift) / steepness
        lean_asked = limit_norm(lean_asked, np.tan(gains.lean))
        e4_asked = weight * (steepness * (pendulum - lean_asked) + drift - s_d[2])
        e6 = -k[5] * e5 - k[4] * (e4 - e4_asked)
        t2 = t_d[2] + stiffness / steepness * (s2 - s_d[2]) - e6 / (weight * steepness)

        yaw = taylor.from_derivatives(
            s.euler[:, 2], s.euler_rate[:, 2], self._yaw_acceleration(s, measurement, vertical)
        )
        euler = taylor.to_derivatives(flat_outputs.attitude_from_tangent(np.stack([*lean, 0.5 * t2]), yaw))
        inertia = np.array([p.inertia_roll, p.inertia_pitch, p.inertia_yaw])
        return np.column_stack([thrust, inertia * euler[2] - estimate.disturbance[:, 6:9]]), memory

    def _yaw_acceleration(self, s: State, measurement: Measurement, w: Floats) -> Floats:
        error, rate = (
            s.euler[:, 2] - measurement.yaw_reference[:, 0],
            s.euler_rate[:, 2] - measurement.yaw_reference[:, 1],
        )
        return np.asarray(measurement.yaw_reference[:, 2] - 2.0 * self.gains.damping * w * rate - w * w * error)

    def _thrust(
        self, estimate: Estimate, measurement: Measurement, lean: Floats, axis_height: Floats, w: Floats
    ) -> Floats:
        """Equation (6), shape (n,), with the thrust's tangents, b_z and ω."""
        p, s = self.simulation.parameters, State(estimate.state)
        on_quadrotor, on_bob = estimate.disturbance[:, 0:3], estimate.disturbance[:, 3:6]
        climb = (
            measurement.reference[:, 0, 2] - 2.0 * self.gains.damping * w * s.velocity[:, 2] - w * w * s.position[:, 2]
        )
        axis = np.column_stack([lean, np.ones_like(axis_height)]) * axis_height[:, np.newaxis]
        pull = (on_bob / p.bob_mass - on_quadrotor / p.quadrotor_mass) / p.rod_length  # without the thrust's
        r, upright = s.direction, s.direction[:, 2]
        rise = pull[:, 2] - (np.sum(r * pull, axis=1) + np.sum(s.direction_rate**2, axis=1)) * upright
        lift = p.total_mass * (p.gravity + climb) - on_quadrotor[:, 2] - on_bob[:, 2]
        effect = axis_height + p.bob_mass / p.quadrotor_mass * (axis_height - np.sum(r * axis, axis=1) * upright)
        thrust = (lift + p.bob_mass * p.rod_length * rise) / np.maximum(effect, 0.1)
        return np.asarray(np.clip(thrust, _LEAST_THRUST * p.hover_thrust, 2.0 * p.hover_thrust))


def _coefficients(bandwidths: list[Floats], damping: float) -> list[Floats]:
    """k₀ … k₅ of Π (s² + 2ζω s + ω²), each of shape (n, 1)."""
    polynomial = [np.ones_like(bandwidths[0])]
    for w in bandwidths:
        shifted = [*polynomial, np.zeros_like(w), np.zeros_like(w)]
        for i, c in enumerate(polynomial):
            shifted[i + 1] = shifted[i + 1] + 2.0 * damping * w * c
            shifted[i + 2] = shifted[i + 2] + w * w * c
        polynomial = shifted
    return [c[:, np.newaxis] for c in polynomial[:0:-1]]
