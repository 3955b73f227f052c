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

A force d on the quadrotor enters at F⁽⁴⁾ = F₅ + δ with δ = −g d/(M l), which the paper's control law neglects. The
*matched* law (`AdrcGains.mismatch` = 1) estimates δ where it enters, with one more DESO for x and one for y:

    (6)  y = K (g r_xy − F̈_d),     ÿ = K (F₅ − F_d⁽⁴⁾) + K δ

With the factor K, the disturbance K δ has the unit and the size of ϑ, so that these DESOs have the gains of those of
(2). The law uses F₅ + δ̂ for F⁽⁴⁾ in (3) and in the Luenberger stage, and the derivative of F₅ + δ̂ for F⁽⁵⁾. The same
holds for a constant force on the bob, which enters at F̈. By (1) and (2), ϑ = K δ + g K (t/I − n̈): ϑ also contains the
difference between the nominal angular acceleration and the true one: errors of the inertia, the rate loop and the gyro.
So the law subtracts ϑ̂ in (3), but does not take ϑ̂/K for δ̂, which a biased gyro makes an estimate of a false force.

The paper assumes ψ → 0. This implementation rotates roll and pitch by ψ into the axes of the world (n and t above),
which makes no difference at ψ = 0.

For rigid vehicles, F, r and the parameters in (1) to (3) are those of the equivalent pendulum (`modelling.equivalent`),
and the tangents r_xy/r_z and b_xy/b_z take the places of r_xy and n, so that (1) and (2) hold at larger tilts. Thrust
and torques in the known inputs of the observers are then those that make the accelerations of the nominal model over
the period, in which rotors and on-board loop follow the action that acts.

Over the known delays and lags of the loop, and over the latency, `estimation.prediction` carries the measured state
forward, with the rates and the disturbance of the observers and the commands under way. The observers' states change as
the chains of the state do (`estimation.chains`). Equations (3) to (5) then give the command for the predicted state.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.estimation import estimator
from quadpend_baselines.estimation.chains import (
    CHAINS,
    DISTURBANCE,
    FORCE,
    HEIGHT,
    HORIZONTAL,
    LUENBERGER,
    RATE,
    VALUE,
    YAW,
    AdrcMeasurement,
    chains_of_state,
    equivalent_measurement,
    make_measurement,
    measurement_of_state,
    state_from_chains,
)
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.observers import ESO_INPUT, LUENBERGER_INPUT, ObserverBank
from quadpend_baselines.estimation.prediction import Estimate, Measurement, Prediction
from quadpend_baselines.gains import ADRC_GAINS, AdrcGains
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.modelling.planar import rotate
from quadpend_baselines.policy.protocol import episode_start_mask, select_rows, to_action, to_command
from quadpend_gym import Parameters, Simulation, read_observation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, Disturbance, State

GainsOrFunction = AdrcGains | Callable[[Simulation], AdrcGains]
_MAX_ESTIMATE = 1e15  # an observer whose states exceed it starts again
_MAX_RATE = 100.0  # rad/s, limit of estimated rates
_MAX_STATE = 1e3  # a predicted state beyond it is not used
_MIN_THRUST_GAIN = 0.1  # lower bound of g_z, as a share of 1/(M + m_c)


class AdrcMemory(NamedTuple):
    """Memory of ADRC for n rows."""

    estimate: Floats  # states of the observers, shape (n, 6, 4), with those of the force (n, 8, 4)
    # Thrust (N) and torques (N·m) that act after the latest measured state, after saturation, shape (n, 4). Those of a
    # plant with `plant` are the mean ones that the nominal model predicts.
    command: Floats
    measurement: AdrcMeasurement | None  # the latest measurement; None in the memory of the continuous-time simulation
    action: Floats32 | tuple[()] = ()  # the action, shape (n, 4); empty in the memory of the continuous-time simulation
    # The latest measured state, for a rigid vehicle or a loop with known delays or lags; otherwise empty
    plant: Estimate | tuple[()] = ()
    following: Estimate | tuple[()] = ()  # the plant one control period later, predicted; empty without `plant`


def _measure(observation: Floats32) -> AdrcMeasurement:
    """Return the measurement of observations, shape (n, 36) or (n, 27)."""
    return make_measurement(
        read_observation(observation, "tracking_error"),
        read_observation(observation, "direction"),
        read_observation(observation, "attitude"),
        read_observation(observation, "yaw_reference"),
        np.stack([read_observation(observation, f"reference_{order}") for order in range(2, 7)], axis=1),
    )


class ADRC(Controller):
    """The paper's controller as a policy with the `predict` protocol.

    Args:
        gains: A name in `ADRC_GAINS` (``"paper"``, ``"matched"``, …), an `AdrcGains`, or a function that returns them
            for a nominal simulation.
        simulation: Nominal plant, torque limits and control period; None: the default simulation.
        loop: The known delays and lags of the loop; None: there are none.
    """

    def __init__(
        self,
        gains: str | GainsOrFunction = "paper",
        simulation: Simulation | None = None,
        loop: Loop | None = None,
    ) -> None:
        """Design the observers and the feedback."""
        if isinstance(gains, str):
            if gains not in ADRC_GAINS:
                raise ValueError(f"there are no ADRC gains {gains!r}; there are {', '.join(ADRC_GAINS)}")
            gains = ADRC_GAINS[gains]
        self.simulation = simulation or Simulation()
        self.model = equivalent_model(self.simulation)
        self.given_gains = gains
        self.gains = gains = gains(self.simulation) if callable(gains) else gains
        known = loop or Loop()
        self._prediction = Prediction(self.simulation, known if gains.predicts else Loop(), gains.predicts)
        # The driven state and the gains of each observer
        self.observers = [
            (LUENBERGER_INPUT, gains.luenberger),
            (LUENBERGER_INPUT, gains.luenberger),
            (ESO_INPUT, gains.horizontal),
            (ESO_INPUT, gains.horizontal),
            (ESO_INPUT, gains.vertical),
            (ESO_INPUT, gains.vertical),
        ]
        if gains.mismatch:
            self.observers += [(ESO_INPUT, gains.horizontal), (ESO_INPUT, gains.horizontal)]
        self._bank = ObserverBank.design(self.observers, self.simulation.period)
        # k₀ … k₅ and k₀, k₁: the coefficients of (s² + 2ζωs + ω²)³ and of s² + 2ζωs + ω², lowest power first
        horizontal = [1.0, 2.0 * gains.damping * gains.horizontal_bandwidth, gains.horizontal_bandwidth**2]
        vertical = [1.0, 2.0 * gains.damping * gains.vertical_bandwidth, gains.vertical_bandwidth**2]
        self.horizontal_gains = np.polymul(np.polymul(horizontal, horizontal), horizontal)[:0:-1]
        self.vertical_gains = np.array(vertical)[:0:-1]

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "ADRC":
        """Return the same controller, designed for another nominal simulation and loop."""
        return type(self)(self.given_gains, simulation, loop)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, AdrcMemory]:
        """Return action and memory; see `Policy.predict`."""
        single = np.ndim(observation) == 1
        observation = np.atleast_2d(np.asarray(observation, np.float32))
        measurement = equivalent_measurement(_measure(observation), self.model)
        outputs = self.observer_outputs(measurement)
        estimate = self.initial_estimate(measurement, outputs)
        started = episode_start_mask(episode_start, state is None, measurement.yaw.size)
        if not started.all():
            # The trapezoidal rule gives the mean of the known inputs over the period.
            before = self.observer_inputs(state.measurement, state.estimate, state.command)
            after = self.observer_inputs(measurement, state.estimate, state.command)
            updated = self._bank.update(state.estimate, 0.5 * (before + after), outputs)
            restarted = started | ~(np.abs(updated).max(axis=(1, 2)) < _MAX_ESTIMATE)  # of nan as well
            if isinstance(state.following, Estimate):
                # A delayed sensor repeats its first sample.
                restarted |= state.following.age <= self._prediction.loop.sensor_delay
            estimate = np.where(restarted[:, np.newaxis, np.newaxis], estimate, updated)
        if self._needs_plant:
            action, memory = self._predicted_action(observation, measurement, estimate, state, started)
        else:
            action, command = to_action(self.command(measurement, estimate), self.simulation)
            memory = AdrcMemory(estimate, command, measurement, action)
        return (action[0] if single else action), memory

    @property
    def _needs_plant(self) -> bool:
        """Whether the actions depend on the vehicle's attitude and rotors, or on the commands under way."""
        return plant_of(self.simulation).memory_size > 0 or self._prediction.memory_size > 0

    def _predicted_action(
        self, observation: Floats32, measurement: AdrcMeasurement, estimate: Floats, before: Any, started: Booleans
    ) -> tuple[Floats32, AdrcMemory]:
        """Return the actions by the predicted state at the time when they act, and the memory."""
        rows, prediction, p = len(started), self._prediction, self._parameters
        measured = estimator.measurement_from_observation(observation, self.simulation.parameters.rod_length)
        state = state_from_chains(measured, measurement, estimate, self.model)
        no_force = np.zeros((rows, DISTURBANCE_SIZE))
        memory, age = np.zeros((rows, prediction.memory_size)), np.zeros(rows, np.int64)
        plant = Estimate(state, no_force, measured.reference, age, memory, prediction.rigid(state), np.ones(rows))
        last = np.zeros((rows, ACTION_SIZE), np.float32)
        if not started.all():
            kept = before.following
            if np.isnan(State(measured.state).euler_rate[:1]).any():
                rate = self._euler_rate(measured, kept)
                State(state).euler_rate[:] = np.where(started[:, np.newaxis], State(state).euler_rate, rate)
            rigid = prediction.rigid(state, kept.rigid[:, ROTOR_THRUST:])
            plant = select_rows(started, plant, plant._replace(age=kept.age, loop=kept.loop, rigid=rigid))
            last = select_rows(started, last, before.action)

        acting = plant._replace(disturbance=self._disturbance(estimate))
        later, then = prediction.carry_forward(acting, last, measured._replace(state=state))
        forecast, outlook = measurement, estimate
        if later is not acting and (bounded := np.abs(later.state).max(axis=1) < _MAX_STATE).any():
            later = select_rows(bounded, later, acting)
            now = measurement_of_state(measured._replace(state=state), self.model)
            forecast = measurement_of_state(then._replace(state=later.state), self.model)
            outlook = estimate.copy()
            outlook[:, :CHAINS] += chains_of_state(then._replace(state=later.state), forecast, self.model)
            outlook[:, :CHAINS] -= chains_of_state(measured._replace(state=state), now, self.model)
        command = self.command(forecast, outlook)
        inertia = [p.inertia_roll, p.inertia_pitch, p.inertia_yaw]
        command[:, 1:] = inertia * self.model.euler_accelerations(later.state, command[:, 1:] / inertia)
        command = self.model.body_command(later.state, command, no_force)
        wanted, _ = to_action(command, self.simulation, later.rigid)
        action = np.nan_to_num(prediction.loop.compensate(wanted, later.loop, self.simulation.period))
        return action, self.with_applied_action(
            AdrcMemory(estimate, command, measurement, action, plant, plant), action
        )

    def _euler_rate(self, measured: Measurement, predicted: Estimate) -> Floats:
        """Return estimated rates of the Euler angles, rad/s, shape (n, 3).

        The predicted rates are corrected by the error of the predicted angles with the bandwidth of the DESO.
        """
        period, angles = self.simulation.period, State(predicted.state)
        error = np.remainder(State(measured.state).euler - angles.euler + np.pi, 2.0 * np.pi) - np.pi
        share = -np.expm1(-self.gains.horizontal.bandwidth * period)
        return np.asarray(np.clip(angles.euler_rate + share / period * error, -_MAX_RATE, _MAX_RATE))

    def with_applied_action(self, memory: AdrcMemory, action: Floats32) -> AdrcMemory:
        """Return the memory for the case that `action`, shape (n, 4), is applied instead of the controller's action."""
        if not isinstance(memory.plant, Estimate) or memory.measurement is None:
            return memory._replace(command=to_command(action, self.simulation), action=action)
        p, plant = self._parameters, memory.plant
        following = self._prediction.advance(plant._replace(reference=np.zeros_like(plant.reference)), action)
        before, after, period = State(plant.state), State(following.state), self.simulation.period
        vertical = (after.velocity[:, 2] - before.velocity[:, 2]) / period
        angular = self.model.angular_accelerations(plant.state, following.state, period)
        thrust = (vertical + p.gravity) / self._limited_thrust_gain(memory.measurement)
        command = np.column_stack([thrust, angular * [p.inertia_roll, p.inertia_pitch, p.inertia_yaw]])
        return memory._replace(command=command, action=action, following=following)

    def estimated_disturbance(self, memory: AdrcMemory) -> Floats:
        """Return the estimated disturbance in the layout of ``info["disturbance"]``, N and N·m, shape (n, 9).

        Near hover, the estimates δ̂ (with the paper's law ϑ̂/K) and ϑ̂ are converted to a force on the quadrotor (world
        frame) and a yaw torque. The other components are zero, because the observers cannot distinguish a force on the
        bob, and with the paper's law a roll or pitch torque, from a force on the quadrotor.
        """
        return self._disturbance(memory.estimate)

    def _disturbance(self, estimate: Floats) -> Floats:
        p = self._parameters
        arm = p.quadrotor_mass * p.rod_length / (1.0 - self.model.pivot_share)
        out = Disturbance(np.zeros((estimate.shape[0], DISTURBANCE_SIZE)))
        observers = FORCE if self.gains.mismatch else HORIZONTAL
        out.force[:, :2] = -estimate[:, observers, DISTURBANCE] * arm / self._stiffness
        out.force[:, 2] = (estimate[:, HEIGHT, DISTURBANCE] + p.gravity) * p.total_mass
        out.torque[:, 2] = estimate[:, YAW, DISTURBANCE] * p.inertia_yaw
        return out.array

    @property
    def _stiffness(self) -> float:
        """The product g K, m/s⁴."""
        return self._parameters.gravity * self._parameters.chain_stiffness

    @property
    def _parameters(self) -> Parameters:
        """The parameters of the equivalent pendulum."""
        return self.model.parameters

    def fourth_derivative(self, measurement: AdrcMeasurement) -> Floats:
        """Return F₅ of equation (1), m/s⁴, shape (n, 2)."""
        return (1.0 - self.model.pivot_share) * self._stiffness * (measurement.pendulum - measurement.tilt)

    def _thrust_gain(self, measurement: AdrcMeasurement) -> Floats:
        """Return g_z of equation (4), 1/kg, shape (n,)."""
        p, axis, r = self._parameters, measurement.thrust_axis, measurement.direction
        projection = np.sum(r * axis, axis=-1) * r[:, 2]
        return np.asarray((axis[:, 2] - p.bob_mass / p.total_mass * projection) / p.quadrotor_mass)

    def _limited_thrust_gain(self, measurement: AdrcMeasurement) -> Floats:
        least = _MIN_THRUST_GAIN / self._parameters.total_mass
        return np.asarray(np.maximum(self._thrust_gain(measurement), least))

    def observer_outputs(self, measurement: AdrcMeasurement) -> Floats:
        """Return the measured output of every observer, shape (n, 6), with those of the force (n, 8)."""
        fourth = self.fourth_derivative(measurement) - measurement.reference_derivative(4)[:, :2]
        error = measurement.error
        outputs = [error[:, :2], fourth, error[:, 2], measurement.yaw_error]
        if self.gains.mismatch:
            outputs.append(self._parameters.chain_stiffness * self._acceleration(measurement))
        return np.column_stack(outputs)

    def _acceleration(self, measurement: AdrcMeasurement) -> Floats:
        """Return g r_xy − F̈_d of equation (6), m/s², shape (n, 2)."""
        pendulum = self.model.sigma(measurement.pendulum, measurement.tilt)
        return np.asarray(self._parameters.gravity * pendulum - measurement.reference_derivative(2)[:, :2])

    def initial_estimate(self, measurement: AdrcMeasurement, outputs: Floats) -> Floats:
        """Return the states of the observers at the start of an episode, shape (n, 6, 4) or (n, 8, 4).

        Rates and disturbances are zero, except F̈ = g r_xy and ϑ_z = −g.
        """
        estimate = np.zeros((*outputs.shape, 4))
        estimate[:, :, VALUE] = outputs
        estimate[:, LUENBERGER, 2] = self._acceleration(measurement)
        estimate[:, HEIGHT, DISTURBANCE] = -self._parameters.gravity
        return estimate

    def command(self, measurement: AdrcMeasurement, estimate: Floats) -> Floats:
        """Return thrust (N) and torques (N·m) by equations (3)–(5), before saturation, shape (n, 4)."""
        p, horizontal = self._parameters, estimate[:, HORIZONTAL]
        errors = [estimate[:, LUENBERGER, order] for order in range(4)]
        errors += [horizontal[..., order] + self._compensated(estimate, order) for order in (VALUE, RATE)]
        feedback = sum(k * error for k, error in zip(self.horizontal_gains, errors, strict=True))
        v = measurement.reference_derivative(6)[:, :2] - feedback - horizontal[..., DISTURBANCE]
        torque = (p.chain_stiffness * self.fourth_derivative(measurement) - v) / self._stiffness
        pitch, roll = (rotate(torque, -measurement.yaw, 0) * [1.0, -1.0]).T
        lift = self._vertical_feedback(measurement.reference_derivative(2)[:, 2], estimate[:, HEIGHT])
        yaw = self._vertical_feedback(measurement.yaw_acceleration, estimate[:, YAW])
        return np.column_stack(
            [
                lift / self._limited_thrust_gain(measurement),
                p.inertia_roll * roll,
                p.inertia_pitch * pitch,
                p.inertia_yaw * yaw,
            ]
        )

    def _compensated(self, estimate: Floats, order: int) -> Floats | float:
        """Return the part of δ̂ (m/s⁴, order 0) or of its rate (order 1) that is fed back, shape (n, 2)."""
        share = self.gains.mismatch / self._parameters.chain_stiffness
        return np.asarray(share * estimate[:, FORCE, DISTURBANCE + order]) if share else 0.0

    def _vertical_feedback(self, acceleration: Floats, estimate: Floats) -> Floats:
        """Return the demanded acceleration of height (4) or yaw (5), the expression in parentheses, shape (n,)."""
        k0, k1 = self.vertical_gains
        return np.asarray(acceleration - k0 * estimate[:, VALUE] - k1 * estimate[:, RATE] - estimate[:, DISTURBANCE])

    def observer_inputs(self, measurement: AdrcMeasurement, estimate: Floats, command: Floats) -> Floats:
        """Return the known input of every observer while `command` is applied, shape (n, 6) or (n, 8)."""
        p = self._parameters
        thrust, roll, pitch, yaw = command.T
        fourth = self.fourth_derivative(measurement)
        angular_acceleration = np.stack([pitch / p.inertia_pitch, -roll / p.inertia_roll], axis=-1)
        horizontal = p.chain_stiffness * fourth - self._stiffness * rotate(angular_acceleration, measurement.yaw, 0)
        reference = measurement.reference_derivative(4)[:, :2]
        inputs = [
            fourth + self._compensated(estimate, VALUE) - reference,
            horizontal - measurement.reference_derivative(6)[:, :2],
            self._thrust_gain(measurement) * thrust - measurement.reference_derivative(2)[:, 2],
            yaw / p.inertia_yaw - measurement.yaw_acceleration,
        ]
        if self.gains.mismatch:
            inputs.append(p.chain_stiffness * (fourth - reference))
        return np.column_stack(inputs)
