"""Extended state observer of the whole plant: prediction with the nonlinear simulation, correction with a Kalman gain.

    (1)  predict   x̂⁻ = f(x̂, u, d̂),          d̂⁻ = d̂                        f: one period of `kernel.advance`
    (2)  correct   x̂  = x̂⁻ + L_x (y − C x̂⁻),  d̂ = d̂⁻ + L_d (y − C x̂⁻)

The extended states d are the forces on quadrotor and bob and the torque, modelled as random walks. The prediction (1)
is that of the simulation itself, with nominal parameters. L is the gain of the Kalman filter for model (1) of
`linear_model`, rotated by the yaw angle. The gain varies over the first steps of an episode, when the forces and, in
output feedback, the rates are unknown; after that it is constant.

Positions and velocities are relative to the reference, which accelerates. The observer therefore subtracts the motion
of the reference over a period, a polynomial of order 6, after the prediction (1).
"""

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from quadpend_baselines.gains import EstimatorGains
from quadpend_baselines.modelling import flat_outputs
from quadpend_baselines.modelling.linear_model import (
    DISTURBANCE_COLUMNS,
    EULER,
    MODEL_BOB_FORCE,
    MODEL_DISTURBANCE_SIZE,
    MODEL_FORCE,
    MODEL_STATE_SIZE,
    MODEL_TORQUE,
    PENDULUM,
    POSITION,
    STATE_COLUMNS,
    linearise,
    rotate_disturbance,
    rotate_state,
)
from quadpend_baselines.modelling.planar import limit_norm
from quadpend_baselines.policy.protocol import select_rows
from quadpend_gym import Simulation, read_observation
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SCALE, OBSERVATION_SIZE, REFERENCE_START

_VARYING_STEPS = 100  # corrections after which the gain is constant
_MAX_HORIZONTAL = 0.95  # bound of |r_xy| of an estimate: 72° from upright; the default limit of an episode is 60°
_MAX_ESTIMATE = (
    300.0  # SI units, limit of disturbance estimates; rows with a larger state estimate restart the observer
)
_MEASURED_COLUMNS = np.r_[POSITION, EULER, PENDULUM]  # columns of x that output feedback measures
# Standard deviations of the estimates at the start of an episode
_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE = 1.0, 0.1, 0.1  # N, N, N·m
_INITIAL_RATE = 0.1  # of every rate that is not measured, SI units


class Measurement(NamedTuple):
    """Observations of n rows, converted for the estimator.

    Attributes:
        state: Layout of `quadpend_gym.physics.state`, shape (n, 18); position and velocity are relative to the
            reference, and rates that are not measured are nan.
        reference: F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3).
        yaw_reference: ψ_d, ψ̇_d, ψ̈_d, in rad, rad/s and rad/s², shape (n, 3).
    """

    state: Floats
    reference: Floats
    yaw_reference: Floats


class Estimate(NamedTuple):
    """Memory of the estimator for n rows.

    Attributes:
        state: x̂, as `Measurement.state` but complete, shape (n, 18).
        disturbance: d̂, in the layout of `Disturbance`, N and N·m, shape (n, 9).
        reference: Reference derivatives of the latest measurement, shape (n, 5, 3).
        age: Number of corrections since the episode began, shape (n,).
    """

    state: Floats
    disturbance: Floats
    reference: Floats
    age: Integers


def measurement_from_observation(observation: Floats32, rod_length: float) -> Measurement:
    """Convert observations, shape (n, 36), or (n, 27) without velocities, into a measurement.

    Args:
        observation: Laid out as in `quadpend_gym.tasks.observation`.
        rod_length: l, m.
    """
    direction = read_observation(observation, "direction")
    yaw_reference = read_observation(observation, "yaw_reference")
    state = np.full((observation.shape[0], STATE_SIZE), np.nan)
    s = State(state)
    to_bob = rod_length * np.array([1.0, 1.0, 0.0])  # the horizontal tracking error is that of the bob
    s.direction[:] = direction
    s.position[:] = read_observation(observation, "tracking_error") - to_bob * direction
    s.euler[:] = read_observation(observation, "attitude")
    s.euler[:, 2] += yaw_reference[:, 0]
    if observation.shape[1] == OBSERVATION_SIZE:
        s.direction_rate[:] = read_observation(observation, "direction_rate")
        s.velocity[:] = read_observation(observation, "tracking_error_rate") - to_bob * s.direction_rate
        s.euler_rate[:] = read_observation(observation, "euler_rate")
    reference = np.stack([read_observation(observation, f"reference_{order}") for order in range(2, 7)], axis=1)
    return Measurement(state, reference, yaw_reference)


def observation_from_state(state: Floats, observation: Floats32, rod_length: float) -> Floats32:
    """Convert states into observations with velocities: the inverse of `measurement_from_observation`.

    Args:
        state: As `Measurement.state` but complete, shape (n, 18).
        observation: Observation at the same time, shape (n, 36) or (n, 27); its reference part is copied.
        rod_length: l, m.

    Returns:
        Observations, shape (n, 36).
    """
    s, to_bob = State(state), rod_length * np.array([1.0, 1.0, 0.0])
    yaw_reference = read_observation(observation, "yaw_reference")[:, :1] * [0.0, 0.0, 1.0]
    out = np.empty((len(state), OBSERVATION_SIZE), np.float32)
    for name, value in {
        "tracking_error": s.position + to_bob * s.direction,
        "tracking_error_rate": s.velocity + to_bob * s.direction_rate,
        "direction": s.direction,
        "direction_rate": s.direction_rate,
        "attitude": s.euler - yaw_reference,
        "euler_rate": s.euler_rate,
    }.items():
        columns = OBSERVATION_FIELDS[name]
        out[:, columns] = value / OBSERVATION_SCALE[columns]
    out[:, REFERENCE_START:] = observation[:, REFERENCE_START - OBSERVATION_SIZE :]
    return out


@dataclass(frozen=True)
class Estimator:
    """The observer (1)–(2).

    Attributes:
        gains: Noise levels of the Kalman filter.
        simulation: Nominal plant and control period.
    """

    gains: EstimatorGains
    simulation: Simulation

    def initial_estimate(self, measurement: Measurement) -> Estimate:
        """Return the estimate at the start of an episode.

        Rates that are not measured are those of the trajectory that follows the reference; the disturbance is zero.
        """
        rows, p = len(measurement.state), self.simulation.parameters
        calm = np.zeros((rows, DISTURBANCE_SIZE))
        trajectory = flat_outputs.flat_trajectory(measurement.reference, calm, p)
        reference_state, _ = flat_outputs.state_and_command(trajectory, measurement.yaw_reference, calm, p)
        state = np.where(np.isnan(measurement.state), reference_state, measurement.state)
        _project_direction(state)
        return Estimate(state, calm, measurement.reference, np.zeros(rows, np.int64))

    def update(self, estimate: Estimate, command: Floats, measurement: Measurement) -> Estimate:
        """Return the estimate one period later, by equations (1)–(2).

        Args:
            estimate: Estimate one period ago.
            command: Thrust (N) and torques (N·m) applied over the period, shape (n, 4).
            measurement: Measurement at the end of the period.
        """
        state, disturbance = self._predict(estimate, command), estimate.disturbance.copy()
        has_rates = not bool(np.isnan(State(measurement.state).velocity[0, 0]))
        table = gain_table(self.gains, self.simulation, has_rates)
        gain = table[np.minimum(estimate.age, len(table) - 1)]
        measured = slice(None) if has_rates else _MEASURED_COLUMNS
        innovation = (measurement.state - state)[:, STATE_COLUMNS]
        yaw = State(state).euler[:, 2].copy()
        correction = np.einsum("nij,nj->ni", gain, rotate_state(innovation, -yaw)[:, measured])
        state[:, STATE_COLUMNS] += rotate_state(correction[:, :MODEL_STATE_SIZE], yaw)
        disturbance[:, DISTURBANCE_COLUMNS] += rotate_disturbance(correction[:, MODEL_STATE_SIZE:], yaw)
        _project_direction(state)
        disturbance[:, DISTURBANCE_COLUMNS] = np.clip(
            disturbance[:, DISTURBANCE_COLUMNS], -_MAX_ESTIMATE, _MAX_ESTIMATE
        )
        bounded = np.abs(state).max(axis=1) < _MAX_ESTIMATE  # false for nan as well
        updated = Estimate(state, disturbance, measurement.reference, estimate.age + 1)
        return updated if bounded.all() else select_rows(bounded, updated, self.initial_estimate(measurement))

    def _predict(self, estimate: Estimate, command: Floats) -> Floats:
        sim = self.simulation
        state = estimate.state.copy()
        parameters = np.tile(sim.parameters.as_array(), (len(state), 1))
        advance(state, command, estimate.disturbance, parameters, sim.period, sim.substeps)
        s = State(state)
        for order, derivative in enumerate(np.moveaxis(estimate.reference, 1, 0), 2):
            s.position[:] -= sim.period**order / factorial(order) * derivative
            s.velocity[:] -= sim.period ** (order - 1) / factorial(order - 1) * derivative
        return state


def _project_direction(state: Floats) -> None:
    """Limit |r_xy|, and set r_z and ṙ_z in place such that |r| = 1, r_z > 0 and r·ṙ = 0."""
    s = State(state)
    s.direction[:, :2] = limit_norm(s.direction[:, :2], _MAX_HORIZONTAL)
    s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
    along = np.sum(s.direction[:, :2] * s.direction_rate[:, :2], axis=1)
    s.direction_rate[:, 2] = -along / s.direction[:, 2]


@lru_cache(maxsize=32)
def gain_table(gains: EstimatorGains, simulation: Simulation, has_rates: bool) -> Floats:
    """Return L of equation (2) for the first 100 corrections; all later corrections use the last one.

    Args:
        gains: Noise levels of the Kalman filter.
        simulation: Nominal plant and control period.
        has_rates: Whether the rates are measured.

    Returns:
        Shape (100, 24, 16), or (100, 24, 8) without measured rates.
    """
    model = linearise(simulation)
    size = MODEL_STATE_SIZE + MODEL_DISTURBANCE_SIZE
    is_state, is_disturbance = slice(0, MODEL_STATE_SIZE), slice(MODEL_STATE_SIZE, size)
    transition = np.eye(size)
    transition[is_state, is_state], transition[is_state, is_disturbance] = model.transition, model.disturbance
    walk = _model_disturbance(gains.force_walk, gains.bob_force_walk, gains.torque_walk)
    process = np.zeros(size)
    process[is_disturbance] = walk**2 * simulation.period
    noise = np.empty(MODEL_STATE_SIZE)
    noise[_MEASURED_COLUMNS] = gains.noise**2
    is_rate = np.setdiff1d(np.arange(MODEL_STATE_SIZE), _MEASURED_COLUMNS)
    noise[is_rate] = gains.rate_noise**2
    measured = np.arange(MODEL_STATE_SIZE) if has_rates else _MEASURED_COLUMNS
    output = np.eye(size)[measured]
    initial_disturbance = _model_disturbance(_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE)
    variance = np.concatenate([noise, initial_disturbance**2])
    if not has_rates:
        variance[is_rate] = _INITIAL_RATE**2
    covariance = np.diag(variance)
    table = []
    for _ in range(_VARYING_STEPS):
        predicted = transition @ covariance @ transition.T + np.diag(process)
        gain = np.linalg.solve(output @ predicted @ output.T + np.diag(noise[measured]), output @ predicted).T
        error_transition = np.eye(size) - gain @ output
        covariance = error_transition @ predicted @ error_transition.T + gain @ np.diag(noise[measured]) @ gain.T
        table.append(gain)
    return np.array(table)


def _model_disturbance(force: float, bob_force: float, torque: float) -> Floats:
    """Return one number per component of d in `linear_model`, shape (8,)."""
    out = np.empty(MODEL_DISTURBANCE_SIZE)
    out[MODEL_FORCE], out[MODEL_BOB_FORCE], out[MODEL_TORQUE] = force, bob_force, torque
    return out
