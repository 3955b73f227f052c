"""ADRC with extended state observers for yaw, height and both horizontal channels: the paper's controller, corrected.

The controller measures positions and angles only: the tracking error e of the flat outputs, the direction r of the
pendulum, and the attitude. With K = (M + m_c) g/(M l), the tilt n = (θ_w, −φ_w) in the axes of the world, and the
torques t = (τθ_w, −τφ_w):

    (1)  F⁽⁴⁾ ≈ F₅ = g K (r_xy − n)                                       (36), (43) corrected
    (2)  F⁽⁶⁾ = u_F + ϑ,     u_F = K F₅ − g K t / I                        (38), (45) corrected
    (3)  v = F_d⁽⁶⁾ − Σ k_i (F̂⁽ⁱ⁾ − F_d⁽ⁱ⁾) − ϑ̂,   t = (I/g) F₅ − (I/(g K)) v     (51), (52) corrected
    (4)  u = (z̈_d − k₁ ė̂_z − k₀ ê_z − ϑ̂_z) / g_z,   g_z = (b_z − m_c/(M+m_c) (r·b) r_z) / M    (23), (18) corrected
    (5)  τψ = I_ψ (ψ̈_d − k₁ ė̂_ψ − k₀ ê_ψ − ϑ̂_ψ)                            (16)

where b is the thrust axis. The observers estimate errors relative to the reference, because observations are in single
precision, which represents small numbers with a small absolute error.

A force d on the quadrotor enters at F⁽⁴⁾ = F₅ − g d/(M l) = F₅ + ϑ/K, which the paper's control law neglects. With
`AdrcGains.mismatch` = 1 (the *matched* law), the controller uses F₅ + ϑ̂/K for F⁽⁴⁾ in (3) and in the Luenberger stage,
and the derivative of F₅ + ϑ̂/K for F⁽⁵⁾.

The paper assumes ψ → 0. This implementation rotates roll and pitch by ψ into the axes of the world (n and t above),
which makes no difference at ψ = 0.

For rigid vehicles, F, r and the parameters in (1) to (3) are those of the equivalent pendulum (`modelling.equivalent`).
The controller follows the rotor thrusts by their nominal lag, which gives the mean thrust and torques of a period, and
takes the body rates from the observation, or from its observers if they are not measured. It does not know the latency.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.observers import ESO_INPUT, LUENBERGER_INPUT, ObserverBank
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains
from quadpend_baselines.modelling.equivalent import (
    body_command,
    design_parameters,
    design_reference,
    equivalent_model,
    reference_offset,
)
from quadpend_baselines.modelling.planar import rotate
from quadpend_baselines.policy.protocol import episode_start_mask, to_action, to_command
from quadpend_baselines.policy.rigid_actions import rotor_response
from quadpend_gym import Parameters, Simulation, read_observation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.physics.rigid_kernel import BODY_RATE, ROTOR_THRUST, rigid_from_state
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, Disturbance, State
from quadpend_gym.tasks.observation import OBSERVATION_SIZE

GainsOrFunction = AdrcGains | Callable[[Simulation], AdrcGains]
# Observers in the bank: Luenberger stages of x and y, DESOs of x and y, height, yaw.
_LUENBERGER, _HORIZONTAL, _HEIGHT, _YAW = slice(0, 2), slice(2, 4), 4, 5
_OBSERVERS = 6
# States of a DESO: output, rate, disturbance ϑ, its rate.
_VALUE, _RATE, _DISTURBANCE = 0, 1, 2
_MAX_RATE = 100.0  # rad/s, limit of the estimated body rates
_MIN_THRUST_GAIN = 0.1  # lower bound of g_z, as a share of 1/(M + m_c)


class AdrcMeasurement(NamedTuple):
    """Inputs of the controller from observations of n rows: positions, angles and the reference.

    Attributes:
        error: e, m, shape (n, 3).
        direction: r, shape (n, 3).
        tilt: n, rad, shape (n, 2).
        thrust_axis: b, shape (n, 3).
        yaw: ψ, rad, shape (n,).
        yaw_error: ψ − ψ_d, rad, shape (n,).
        reference: F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3).
        yaw_acceleration: ψ̈_d, rad/s², shape (n,).
    """

    error: Floats
    direction: Floats
    tilt: Floats
    thrust_axis: Floats
    yaw: Floats
    yaw_error: Floats
    reference: Floats
    yaw_acceleration: Floats

    def reference_derivative(self, order: int) -> Floats:
        """Return F_d⁽ⁱ⁾ of one order i from 2 to 6, shape (n, 3)."""
        return self.reference[:, order - 2]


class RotorMemory(NamedTuple):
    """Rotors of n rigid vehicles in the latest control period.

    Attributes:
        rigid: Quaternion, body rate and rotor thrusts (N) at its beginning, shape (n, 11).
        thrusts: Rotor thrusts at its end, N, shape (n, 4).
        reaction: Torques about the body's axes that do not accelerate the Euler angles, after a zero for the thrust,
            N·m, shape (n, 4).
    """

    rigid: Floats
    thrusts: Floats
    reaction: Floats


class AdrcMemory(NamedTuple):
    """Memory of ADRC for n rows.

    Attributes:
        estimate: States of the observers, shape (n, 6, 4).
        command: Thrust (N) and torques (N·m) applied after saturation, shape (n, 4).
        measurement: The latest measurement; None in the memory of the continuous-time simulation.
        rotors: The rotors of rigid vehicles; otherwise empty.
    """

    estimate: Floats
    command: Floats
    measurement: AdrcMeasurement | None
    rotors: RotorMemory | tuple[()] = ()


def make_measurement(
    error: Floats, direction: Floats, euler: Floats, yaw_reference: Floats, reference: Floats
) -> AdrcMeasurement:
    """Return the measurement of n rows.

    Args:
        error: e, m, shape (n, 3).
        direction: r, shape (n, 3).
        euler: φ, θ and the yaw error ψ − ψ_d, rad, shape (n, 3).
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d, in rad, rad/s and rad/s², shape (n, 3).
        reference: F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3).
    """
    roll, pitch, yaw_error = euler.T
    yaw = yaw_error + yaw_reference[:, 0]
    # In the axes of the heading, the horizontal thrust direction is (cos φ sin θ, −sin φ).
    horizontal = np.stack([np.cos(roll) * np.sin(pitch), -np.sin(roll)], axis=-1)
    tilt = rotate(np.stack([pitch, -roll], axis=-1), yaw, 0)
    axis = np.column_stack([rotate(horizontal, yaw, 0), np.cos(roll) * np.cos(pitch)])
    return AdrcMeasurement(error, direction, tilt, axis, yaw, yaw_error, reference, yaw_reference[:, 2])


def measurement_from_observation(observation: Floats32) -> AdrcMeasurement:
    """Return the measurement of observations, shape (n, 36) or (n, 27)."""
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
        gains: A name in `ADRC_GAINS` (``"paper"``, ``"matched"``, …), an `AdrcGains`, or a function that returns them
            for a nominal simulation.
        simulation: Nominal plant, torque limits and control period; None: the default simulation.

    Raises:
        ValueError: If no gains have this name.
    """

    def __init__(self, gains: str | GainsOrFunction = "paper", simulation: Simulation | None = None) -> None:
        """Design the observers and the feedback."""
        if isinstance(gains, str):
            if gains not in ADRC_GAINS:
                raise ValueError(f"there are no ADRC gains {gains!r}; there are {', '.join(ADRC_GAINS)}")
            gains = ADRC_GAINS[gains]
        self.simulation = simulation or Simulation()
        self.given_gains = gains
        self.gains = gains = gains(self.simulation) if callable(gains) else gains
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
        horizontal = [1.0, 2.0 * gains.damping * gains.horizontal_bandwidth, gains.horizontal_bandwidth**2]
        vertical = [1.0, 2.0 * gains.damping * gains.vertical_bandwidth, gains.vertical_bandwidth**2]
        self.horizontal_gains = np.polymul(np.polymul(horizontal, horizontal), horizontal)[:0:-1]
        self.vertical_gains = np.array(vertical)[:0:-1]

    def with_simulation(self, simulation: Simulation) -> "ADRC":
        """Return the same controller, designed for another nominal simulation."""
        return type(self)(self.given_gains, simulation)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, AdrcMemory]:
        """Return action and memory; see `Policy.predict`."""
        single = np.ndim(observation) == 1
        observation = np.atleast_2d(np.asarray(observation, np.float32))
        measurement = measurement_from_observation(observation)
        measurement = self._equivalent_measurement(measurement)
        outputs = self.observer_outputs(measurement)
        estimate = self.initial_estimate(measurement, outputs)
        started = episode_start_mask(episode_start, state is None, measurement.yaw.size)
        if not started.all():
            # The trapezoidal rule gives the mean of the known inputs over the period.
            before = self.observer_inputs(state.measurement, state.estimate, state.command)
            after = self.observer_inputs(measurement, state.estimate, state.command)
            updated = self._bank.update(state.estimate, 0.5 * (before + after), outputs)
            estimate = np.where(started[:, np.newaxis, np.newaxis], estimate, updated)
        command = self.command(measurement, estimate)
        if self.simulation.is_rigid:
            action, memory = self._rigid_action(
                measurement, estimate, command, self._euler_rate(observation, measurement, estimate), state, started
            )
            return (action[0] if single else action), memory
        action, command = to_action(command, self.simulation)
        return (action[0] if single else action), AdrcMemory(estimate, command, measurement)

    def _equivalent_measurement(self, measurement: AdrcMeasurement) -> AdrcMeasurement:
        """Return the measurement of a rigid vehicle with the errors and the reference of the equivalent pendulum."""
        if not self.simulation.is_rigid:
            return measurement
        model, reference = equivalent_model(self.simulation), measurement.reference
        offset = model.pendulum_arm * measurement.direction[:, :2] + model.thrust_arm * measurement.tilt
        error = measurement.error.copy()
        error[:, :2] += offset - reference_offset(reference, self.simulation)
        return measurement._replace(error=error, reference=design_reference(reference, self.simulation))

    def _euler_rate(self, observation: Floats32, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Return the rates of φ, θ, ψ, rad/s, shape (n, 3): measured, or estimated if they are not measured."""
        if observation.shape[1] == OBSERVATION_SIZE:
            return read_observation(observation, "euler_rate")
        # The rates of r and n follow from F⁽³⁾ = g σ̇ and from the rate of F₅.
        third = measurement.reference_derivative(3)[:, :2] + estimate[:, _LUENBERGER, 3]
        fifth = measurement.reference_derivative(5)[:, :2] + estimate[:, _HORIZONTAL, _RATE]
        tilt_rate = third / self._parameters.gravity - fifth / self._stiffness
        pitch_rate, roll_rate = (rotate(tilt_rate, -measurement.yaw, 0) * [1.0, -1.0]).T
        rates = np.column_stack([roll_rate, pitch_rate, estimate[:, _YAW, _RATE]])
        return np.asarray(np.clip(rates, -_MAX_RATE, _MAX_RATE))

    def _rigid_action(
        self,
        measurement: AdrcMeasurement,
        estimate: Floats,
        command: Floats,
        euler_rate: Floats,
        before: Any,
        started: Booleans,
    ) -> tuple[Floats32, AdrcMemory]:
        """Return the actions and the memory of rigid vehicles for thrust and torques for the Euler angles."""
        simulation, rows = self.simulation, len(command)
        state = np.zeros((rows, STATE_SIZE))
        s = State(state)
        pitch, roll = (rotate(measurement.tilt, -measurement.yaw, 0) * [1.0, -1.0]).T
        s.euler[:] = np.column_stack([roll, pitch, measurement.yaw])
        s.direction[:] = measurement.direction
        s.euler_rate[:] = euler_rate
        body = body_command(state, command, np.zeros((rows, DISTURBANCE_SIZE)), simulation)
        rigid = rigid_from_state(state, simulation)
        if not started.all():
            kept = ~started
            rigid[kept, ROTOR_THRUST:] = before.rotors.thrusts[kept]
        action, _ = to_action(body, simulation, rigid)
        return action, self._driven(AdrcMemory(estimate, command, measurement), action, rigid, body - command)

    def _driven(self, memory: AdrcMemory, action: Floats32, rigid: Floats, reaction: Floats) -> AdrcMemory:
        """Return the memory with the mean command that `action` makes, and with the rotors at the end of the period."""
        rate, thrusts = rigid[:, BODY_RATE:ROTOR_THRUST], rigid[:, ROTOR_THRUST:]
        mean, end = rotor_response(action, rate, thrusts, self.simulation)
        return memory._replace(command=mean - reaction, rotors=RotorMemory(rigid, end, reaction))

    def estimated_disturbance(self, memory: AdrcMemory) -> Floats:
        """Return the estimated disturbance in the layout of ``info["disturbance"]``, N and N·m, shape (n, 9).

        Near hover, the estimates ϑ̂ are converted to a force on the quadrotor (world frame) and a yaw torque. The other
        components are zero, because the observers cannot distinguish a force on the bob, a roll torque or a pitch
        torque from a force on the quadrotor.
        """
        p, estimate = self._parameters, memory.estimate
        out = Disturbance(np.zeros((estimate.shape[0], DISTURBANCE_SIZE)))
        out.force[:, :2] = -estimate[:, _HORIZONTAL, _DISTURBANCE] * p.quadrotor_mass * p.rod_length / self._stiffness
        out.force[:, 2] = (estimate[:, _HEIGHT, _DISTURBANCE] + p.gravity) * p.total_mass
        out.torque[:, 2] = estimate[:, _YAW, _DISTURBANCE] * p.inertia_yaw
        return out.array

    def with_applied_action(self, memory: AdrcMemory, action: Floats32) -> AdrcMemory:
        """Return the memory for the case that `action`, shape (n, 4), is applied instead of the controller's action."""
        if isinstance(memory.rotors, RotorMemory):
            return self._driven(memory, action, memory.rotors.rigid, memory.rotors.reaction)
        return memory._replace(command=to_command(action, self.simulation))

    @property
    def _stiffness(self) -> float:
        """The product g K, m/s⁴."""
        return self._parameters.gravity * self._parameters.chain_stiffness

    @property
    def _parameters(self) -> Parameters:
        """The parameters of the equivalent pendulum."""
        return design_parameters(self.simulation)

    def fourth_derivative(self, measurement: AdrcMeasurement) -> Floats:
        """Return F₅ of equation (1), m/s⁴, shape (n, 2)."""
        share = equivalent_model(self.simulation).pivot_share
        return (1.0 - share) * self._stiffness * (measurement.direction[:, :2] - measurement.tilt)

    def _pendulum(self, measurement: AdrcMeasurement) -> Floats:
        """Return σ of the equivalent pendulum, r_xy without a rigid vehicle, shape (n, 2)."""
        share = equivalent_model(self.simulation).pivot_share
        return measurement.direction[:, :2] + share * (measurement.tilt - measurement.direction[:, :2])

    def _thrust_gain(self, measurement: AdrcMeasurement) -> Floats:
        """Return g_z of equation (4), 1/kg, shape (n,)."""
        p, axis, r = self._parameters, measurement.thrust_axis, measurement.direction
        projection = np.sum(r * axis, axis=-1) * r[:, 2]
        return np.asarray((axis[:, 2] - p.bob_mass / p.total_mass * projection) / p.quadrotor_mass)

    def observer_outputs(self, measurement: AdrcMeasurement) -> Floats:
        """Return the measured output of every observer, shape (n, 6)."""
        fourth = self.fourth_derivative(measurement) - measurement.reference_derivative(4)[:, :2]
        error = measurement.error
        return np.column_stack([error[:, :2], fourth, error[:, 2], measurement.yaw_error])

    def initial_estimate(self, measurement: AdrcMeasurement, outputs: Floats) -> Floats:
        """Return the states of the observers at the start of an episode, shape (n, 6, 4).

        Rates and disturbances are zero, except F̈ = g r_xy and ϑ_z = −g.
        """
        gravity = self._parameters.gravity
        estimate = np.zeros((outputs.shape[0], _OBSERVERS, 4))
        estimate[:, :, _VALUE] = outputs
        acceleration = gravity * self._pendulum(measurement) - measurement.reference_derivative(2)[:, :2]
        estimate[:, _LUENBERGER, 2] = acceleration
        estimate[:, _HEIGHT, _DISTURBANCE] = -gravity
        return estimate

    def command(self, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Return thrust (N) and torques (N·m) by equations (3)–(5), before saturation, shape (n, 4)."""
        p, horizontal = self._parameters, estimate[:, _HORIZONTAL]
        disturbance = horizontal[..., _DISTURBANCE]
        errors = [estimate[:, _LUENBERGER, order] for order in range(4)]
        share = self.gains.mismatch / p.chain_stiffness
        errors += [horizontal[..., i] + share * horizontal[..., i + _DISTURBANCE] for i in (_VALUE, _RATE)]
        feedback = sum(k * error for k, error in zip(self.horizontal_gains, errors, strict=True))
        v = measurement.reference_derivative(6)[:, :2] - feedback - disturbance
        torque = (p.chain_stiffness * self.fourth_derivative(measurement) - v) / self._stiffness
        pitch, roll = (rotate(torque, -measurement.yaw, 0) * [1.0, -1.0]).T
        lift = self._vertical_feedback(measurement.reference_derivative(2)[:, 2], estimate[:, _HEIGHT])
        yaw = self._vertical_feedback(measurement.yaw_acceleration, estimate[:, _YAW])
        return np.column_stack(
            [
                lift / np.maximum(self._thrust_gain(measurement), _MIN_THRUST_GAIN / p.total_mass),
                p.inertia_roll * roll,
                p.inertia_pitch * pitch,
                p.inertia_yaw * yaw,
            ]
        )

    def _vertical_feedback(self, acceleration: Floats, estimate: Floats) -> Floats:
        """Return the demanded acceleration of height (4) or yaw (5), the expression in parentheses, shape (n,)."""
        k0, k1 = self.vertical_gains
        return np.asarray(acceleration - k0 * estimate[:, _VALUE] - k1 * estimate[:, _RATE] - estimate[:, _DISTURBANCE])

    def observer_inputs(self, measurement: AdrcMeasurement, estimate: Floats, command: Floats) -> Floats:
        """Return the known input of every observer while `command` is applied, shape (n, 6)."""
        p = self._parameters
        thrust, roll, pitch, yaw = command.T
        fourth = self.fourth_derivative(measurement)
        mismatch = self.gains.mismatch / p.chain_stiffness * estimate[:, _HORIZONTAL, _DISTURBANCE]
        angular_acceleration = np.stack([pitch / p.inertia_pitch, -roll / p.inertia_roll], axis=-1)
        horizontal = p.chain_stiffness * fourth - self._stiffness * rotate(angular_acceleration, measurement.yaw, 0)
        return np.column_stack(
            [
                fourth + mismatch - measurement.reference_derivative(4)[:, :2],
                horizontal - measurement.reference_derivative(6)[:, :2],
                self._thrust_gain(measurement) * thrust - measurement.reference_derivative(2)[:, 2],
                yaw / p.inertia_yaw - measurement.yaw_acceleration,
            ]
        )
