"""ADRC with extended state observers for yaw, height and both horizontal channels: the paper's controller, corrected.

The measurements are positions and angles alone: the tracking error e of the flat outputs, the pendulum's direction r,
and the attitude. With K = (M + m_c) g/(M l), the yaw turned out of the tilt, n = (θ_w, −φ_w), and t = (τθ_w, −τφ_w):

    (1)  F⁽⁴⁾ ≈ F₅ = g K (r_xy − n)                                       (36), (43) corrected
    (2)  F⁽⁶⁾ = u_F + ϑ,     u_F = K F₅ − g K t / I                        (38), (45) corrected
    (3)  v = F_d⁽⁶⁾ − Σ k_i (F̂⁽ⁱ⁾ − F_d⁽ⁱ⁾) − ϑ̂,   t = (I/g) F₅ − (I/(g K)) v     (51), (52) corrected
    (4)  u = (z̈_d − k₁ ė̂_z − k₀ ê_z − ϑ̂_z) / g_z,   g_z = (b_z − m_c/(M+m_c) (r·b) r_z) / M    (23), (18) corrected
    (5)  τψ = I_ψ (ψ̈_d − k₁ ė̂_ψ − k₀ ê_ψ − ϑ̂_ψ)                            (16)

with b the thrust axis. Everything runs on errors against the reference, so that single-precision observations of small
numbers lose nothing. A force d on the quadrotor enters at F⁽⁴⁾ = F₅ − g d/(M l) = F₅ + ϑ/K, which the paper's law
overlooks; `AdrcGains.mismatch` = 1 uses F₅ + ϑ̂/K for F⁽⁴⁾ in (3) and in the Luenberger stage,
and its derivative for F⁽⁵⁾.

The paper assumes ψ → 0. Here roll and pitch are turned by ψ into the world's axes (n and t above), the same at ψ = 0.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.observers import ESO_INPUT, LUENBERGER_INPUT, ObserverBank
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains
from quadpend_baselines.modelling.planar import rotate
from quadpend_baselines.policy.protocol import episode_start_mask, to_action, to_command
from quadpend_gym import Simulation, read_observation
from quadpend_gym.core.arrays import Floats, Floats32

# The observers in the bank: Luenberger stages of x and y, DESOs of x and y, height, yaw.
_LUENBERGER, _HORIZONTAL, _HEIGHT, _YAW = slice(0, 2), slice(2, 4), 4, 5
_OBSERVERS = 6


class AdrcMemory(NamedTuple):
    """What ADRC remembers from one call to the next, for n rows.

    Attributes:
        estimate: the observers' states, shape (n, 6, 4).
        command: thrust (N) and torques (N·m) really given, after saturation, shape (n, 4).
        measurement: at that sample.
    """

    estimate: Floats
    command: Floats
    measurement: Any  # a AdrcMeasurement


class AdrcMeasurement(NamedTuple):
    """What the controller takes from an observation, n rows: positions, angles and the reference."""

    error: Floats  # e, m, (n, 3)
    direction: Floats  # r, (n, 3)
    tilt: Floats  # n, rad, (n, 2)
    thrust_axis: Floats  # b, (n, 3)
    yaw: Floats  # ψ, rad, (n,)
    yaw_error: Floats  # rad, (n,)
    reference: Floats  # F_d⁽ⁱ⁾ for i = 2 … 6, (n, 5, 3)
    yaw_acceleration: Floats  # ψ̈_d, (n,)


def make_measurement(
    error: Floats, direction: Floats, euler: Floats, yaw_reference: Floats, reference: Floats
) -> AdrcMeasurement:
    """What the controller works with, from what is measurement in n rows.

    Args:
        error: e, m, shape (n, 3).
        direction: r, shape (n, 3).
        euler: φ, θ and the yaw error ψ − ψ_d, rad, shape (n, 3).
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d, shape (n, 3).
        reference: F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3).
    """
    roll, pitch, yaw_error = euler.T
    yaw = yaw_error + yaw_reference[:, 0]
    # In the heading's axes the thrust leans by (cos φ sin θ, −sin φ).
    lean = np.stack([np.cos(roll) * np.sin(pitch), -np.sin(roll)], axis=-1)
    tilt = rotate(np.stack([pitch, -roll], axis=-1), yaw, 0)
    axis = np.column_stack([rotate(lean, yaw, 0), np.cos(roll) * np.cos(pitch)])
    return AdrcMeasurement(error, direction, tilt, axis, yaw, yaw_error, reference, yaw_reference[:, 2])


def measurement_from_observation(observation: Floats32) -> AdrcMeasurement:
    return make_measurement(
        read_observation(observation, "tracking_error"),
        read_observation(observation, "direction"),
        read_observation(observation, "attitude"),
        read_observation(observation, "yaw_reference"),
        np.stack([read_observation(observation, f"reference_{order}") for order in range(2, 7)], axis=1),
    )


class ADRC:
    """The paper's controller as a policy with the `predict` protocol.

    Args:
        gains: a name in `ADRC_GAINS` (``"paper"`` or ``"matched"``) or gains of your own.
        simulation: what the controller believes of the plant and its actuators, and its period.

    Raises:
        ValueError: there are no gains of that name.
    """

    def __init__(self, gains: str | AdrcGains = "paper", simulation: Simulation | None = None) -> None:
        """Design the observers and the feedback."""
        if isinstance(gains, str):
            if gains not in ADRC_GAINS:
                raise ValueError(f"there are no ADRC gains {gains!r}; there are {', '.join(ADRC_GAINS)}")
            gains = ADRC_GAINS[gains]
        self.gains = gains
        self.simulation = simulation or Simulation()
        self._bank = ObserverBank.design(
            [
                (LUENBERGER_INPUT, gains.luenberger),
                (LUENBERGER_INPUT, gains.luenberger),
                (ESO_INPUT, gains.horizontal),
                (ESO_INPUT, gains.horizontal),
                (ESO_INPUT, gains.vertical),
                (ESO_INPUT, gains.vertical),
            ],
            self.simulation.period,
        )
        # k₀ … k₅ and k₀, k₁: the coefficients of (s² + 2ζωs + ω²)³ and of s² + 2ζωs + ω², lowest power first
        slow = [1.0, 2.0 * gains.damping * gains.horizontal_bandwidth, gains.horizontal_bandwidth**2]
        fast = [1.0, 2.0 * gains.damping * gains.vertical_bandwidth, gains.vertical_bandwidth**2]
        self.horizontal_gains = np.polymul(np.polymul(slow, slow), slow)[:0:-1]
        self._vertical_gains = np.array(fast)[:0:-1]

    def with_simulation(self, simulation: Simulation) -> "ADRC":
        """The same controller, for another nominal simulation."""
        return type(self)(self.gains, simulation)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, AdrcMemory]:
        """Action and memory; see `Policy.predict`."""
        single = np.ndim(observation) == 1
        measurement = measurement_from_observation(np.atleast_2d(np.asarray(observation, np.float32)))
        outputs = self.observer_outputs(measurement)
        estimate = self.initial_estimate(measurement, outputs)
        started = episode_start_mask(episode_start, state is None, measurement.yaw.size)
        if not started.all():
            inputs = [
                self.observer_inputs(at, state.estimate, state.command) for at in (state.measurement, measurement)
            ]
            updated = self._bank.update(state.estimate, 0.5 * (inputs[0] + inputs[1]), outputs)
            estimate = np.where(started[:, np.newaxis, np.newaxis], estimate, updated)
        command = self.command(measurement, estimate)
        action, command = to_action(command, self.simulation)
        return (action[0] if single else action), AdrcMemory(estimate, command, measurement)

    def estimated_disturbance(self, memory: AdrcMemory) -> Floats:
        """The disturbance that the observers see, as `info["disturbance"]` has the true one, shape (n, 9).

        A force on the quadrotor (N, world) and a yaw torque (N·m) that would explain ϑ̂ near hover; the other columns,
        which the observers cannot tell apart from these, are zero.
        """
        p = self.simulation.parameters
        out = np.zeros((memory.estimate.shape[0], 9))
        out[:, 0:2] = -memory.estimate[:, _HORIZONTAL, 2] * p.quadrotor_mass * p.rod_length / self._stiffness
        out[:, 2] = (memory.estimate[:, _HEIGHT, 2] + p.gravity) * p.total_mass
        out[:, 8] = memory.estimate[:, _YAW, 2] * p.inertia_yaw
        return out

    def with_applied_action(self, memory: AdrcMemory, action: Floats32) -> AdrcMemory:
        """What is remembered if `action`, shape (n, 4), acts and not the controller's own."""
        return memory._replace(command=to_command(action, self.simulation))

    @property
    def _stiffness(self) -> float:
        """g K, m/s⁴."""
        return self.simulation.parameters.gravity * self.simulation.parameters.chain_stiffness

    def fourth_derivative(self, measurement: AdrcMeasurement) -> Floats:
        """F₅ of equation (1), shape (n, 2)."""
        return self._stiffness * (measurement.direction[:, :2] - measurement.tilt)

    def _thrust_gain(self, measurement: AdrcMeasurement) -> Floats:
        """g_z of equation (4), 1/kg, shape (n,)."""
        p, axis, r = self.simulation.parameters, measurement.thrust_axis, measurement.direction
        along = np.sum(r * axis, axis=-1) * r[:, 2]
        return np.asarray((axis[:, 2] - p.bob_mass / p.total_mass * along) / p.quadrotor_mass)

    def observer_outputs(self, measurement: AdrcMeasurement) -> Floats:
        """What each observer measures, shape (n, 6)."""
        fourth = self.fourth_derivative(measurement) - measurement.reference[:, 4 - 2, :2]
        return np.column_stack([measurement.error[:, :2], fourth, measurement.error[:, 2], measurement.yaw_error])

    def initial_estimate(self, measurement: AdrcMeasurement, outputs: Floats) -> Floats:
        """Where the observers start: rates unknown, F̈ = g r, and gravity known, shape (n, 6, 4)."""
        gravity = self.simulation.parameters.gravity
        estimate = np.zeros((outputs.shape[0], _OBSERVERS, 4))
        estimate[:, :, 0] = outputs
        estimate[:, _LUENBERGER, 2] = gravity * measurement.direction[:, :2] - measurement.reference[:, 2 - 2, :2]
        estimate[:, _HEIGHT, 2] = -gravity
        return estimate

    def command(self, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Equations (3)–(5): thrust and torques, shape (n, 4)."""
        p = self.simulation.parameters
        disturbance = estimate[:, _HORIZONTAL, 2]
        errors = [estimate[:, _LUENBERGER, order] for order in range(4)]
        share = self.gains.mismatch / p.chain_stiffness
        errors += [estimate[:, _HORIZONTAL, i] + share * estimate[:, _HORIZONTAL, i + 2] for i in range(2)]
        feedback = sum(k * error for k, error in zip(self.horizontal_gains, errors, strict=True))
        v = measurement.reference[:, 6 - 2, :2] - feedback - disturbance
        torque = (p.chain_stiffness * self.fourth_derivative(measurement) - v) / self._stiffness
        pitch, roll = (rotate(torque, -measurement.yaw, 0) * [1.0, -1.0]).T
        k0, k1 = self._vertical_gains
        height, yaw = estimate[:, _HEIGHT], estimate[:, _YAW]
        lift = measurement.reference[:, 2 - 2, 2] - k0 * height[:, 0] - k1 * height[:, 1] - height[:, 2]
        turn = measurement.yaw_acceleration - k0 * yaw[:, 0] - k1 * yaw[:, 1] - yaw[:, 2]
        return np.column_stack(
            [
                lift / np.maximum(self._thrust_gain(measurement), 0.1 / p.total_mass),
                p.inertia_roll * roll,
                p.inertia_pitch * pitch,
                p.inertia_yaw * turn,
            ]
        )

    def observer_inputs(self, measurement: AdrcMeasurement, estimate: Floats, command: Floats) -> Floats:
        """What drives each chain at this instant, given the command that acts, shape (n, 6)."""
        p = self.simulation.parameters
        fourth = self.fourth_derivative(measurement)
        mismatch = self.gains.mismatch / p.chain_stiffness * estimate[:, _HORIZONTAL, 2]
        body = np.stack([command[:, 2] / p.inertia_pitch, -command[:, 1] / p.inertia_roll], axis=-1)
        horizontal = p.chain_stiffness * fourth - self._stiffness * rotate(body, measurement.yaw, 0)
        lift = self._thrust_gain(measurement) * command[:, 0]
        return np.column_stack(
            [
                fourth + mismatch - measurement.reference[:, 4 - 2, :2],
                horizontal - measurement.reference[:, 6 - 2, :2],
                lift - measurement.reference[:, 2 - 2, 2],
                command[:, 3] / p.inertia_yaw - measurement.yaw_acceleration,
            ]
        )
