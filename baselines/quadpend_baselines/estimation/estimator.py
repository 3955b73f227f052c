"""Extended state observer of the whole plant: prediction with the nonlinear simulation, correction with a Kalman gain.

    (1)  predict   x̂⁻ = f(x̂, u, d̂),          d̂⁻ = d̂                        f: one period of `kernel.advance`
    (2)  correct   x̂  = x̂⁻ + L_x (y − C x̂⁻),  d̂ = d̂⁻ + L_d (y − C x̂⁻)

    (3)  weight    μ̂ ← μ̂ − ε d̂_z/((M + m) g),   d̂_z ← (1 − ε) d̂_z          ε = 1 − e^(−T/mass_time)

The extended states d are the forces on quadrotor and bob and the torque, modelled as random walks. The prediction (1)
is that of the simulation itself, with nominal parameters. L is the gain of the Kalman filter for model (1) of
`linear_model`, rotated by the yaw angle; the torque on a rigid vehicle is a vector of the world frame. The gain varies
over the first steps of an episode, when the forces and, in output feedback, the rates are unknown; after that it is
constant.

μ̂ is an effective ratio of weight to thrust, relative to the nominal one. Equation (3) attributes every lasting vertical
force to it: other masses, but also slow vertical wind and errors of the thrust. At hover these cannot be distinguished,
but a law that takes the weight of a heavy vehicle for a downward wind overestimates the effect of the tilt on the
pendulum. μ̂ scales the masses of quadrotor and pole, but not the moments of inertia.

The prediction (1) is that of `prediction`, which applies the known delays and lags of the loop to u.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.prediction import Estimate, Measurement, Prediction, project_direction
from quadpend_baselines.gains import EstimatorGains
from quadpend_baselines.modelling.equivalent import equivalent_model
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
from quadpend_baselines.policy.protocol import select_rows
from quadpend_gym import Simulation, read_observation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import DISTURBANCE_SIZE, FORCE, STATE_SIZE, State
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SCALE, OBSERVATION_SIZE, REFERENCE_START

_VARYING_STEPS = 100  # corrections after which the gain is constant
_MAX_ESTIMATE = (
    300.0  # SI units, limit of disturbance estimates; rows with a larger state estimate restart the observer
)
_MASS_RATIOS = 0.5, 2.0  # bounds of μ̂
_MEASURED_COLUMNS = np.r_[POSITION, EULER, PENDULUM]  # columns of x that output feedback measures
# Standard deviations of the estimates at the start of an episode
_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE = 1.0, 0.1, 0.1  # N, N, N·m
_INITIAL_RATE = 0.1  # of every rate that is not measured, SI units


def measurement_from_observation(observation: Floats32, rod_length: float) -> Measurement:
    """Convert observations, shape (n, 36), or (n, 27) without velocities, into a measurement; l in m."""
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


def replace_reference(observation: Floats32, measurement: Measurement) -> Floats32:
    """Return observations, shape (n, 36) or (n, 27), with the reference of `measurement`."""
    out = observation.copy()
    orders = measurement.reference.reshape(len(out), -1)
    reference = np.concatenate([orders, measurement.yaw_reference], axis=1)
    out[:, REFERENCE_START - OBSERVATION_SIZE :] = reference / OBSERVATION_SCALE[REFERENCE_START:]
    return out


@dataclass(frozen=True)
class Estimator:
    """The observer (1)–(2)."""

    gains: EstimatorGains  # noise levels of the Kalman filter
    simulation: Simulation  # nominal plant and control period
    loop: Loop = field(default_factory=Loop)  # the known part of the loop; it is left out if `gains.predicts` is False

    @cached_property
    def prediction(self) -> Prediction:
        """The prediction (1)."""
        return Prediction(self.simulation, self.loop if self.gains.predicts else Loop(), self.gains.predicts)

    def initial_estimate(self, measurement: Measurement) -> Estimate:
        """Return the estimate at the start of an episode.

        Rates that are not measured are those of the trajectory that follows the reference; the disturbance is zero.
        """
        rows = len(measurement.state)
        calm = np.zeros((rows, DISTURBANCE_SIZE))
        model = equivalent_model(self.simulation)
        reference_state, _ = model.trajectory(measurement.reference, measurement.yaw_reference, calm)
        state = np.where(np.isnan(measurement.state), reference_state, measurement.state)
        project_direction(state)
        memory = np.zeros((rows, self.prediction.memory_size))
        rigid = self.prediction.rigid(state)
        age, none = np.zeros(rows, np.int64), np.zeros_like(state)
        return Estimate(state, calm, measurement.reference, age, memory, rigid, np.ones(rows), none)

    def update(self, estimate: Estimate, action: Floats32, measurement: Measurement) -> Estimate:
        """Return the estimate one period later, by equations (1)–(2)."""
        predicted = self.prediction.advance(estimate, action)
        state, disturbance = predicted.state, estimate.disturbance.copy()
        has_rates = not bool(np.isnan(State(measurement.state).velocity[0, 0]))
        table = gain_table(self.gains, self.simulation, has_rates)
        gain = table[np.minimum(estimate.age, len(table) - 1)]
        measured = slice(None) if has_rates else _MEASURED_COLUMNS
        innovation = measurement.state - state
        yaw = State(state).euler[:, 2].copy()
        correction = np.einsum("nij,nj->ni", gain, rotate_state(innovation[:, STATE_COLUMNS], -yaw)[:, measured])
        state[:, STATE_COLUMNS] += rotate_state(correction[:, :MODEL_STATE_SIZE], yaw)
        disturbance[:, DISTURBANCE_COLUMNS] += rotate_disturbance(
            correction[:, MODEL_STATE_SIZE:], yaw, plant_of(self.simulation).torque_in_world
        )
        project_direction(state)
        disturbance[:, DISTURBANCE_COLUMNS] = np.clip(
            disturbance[:, DISTURBANCE_COLUMNS], -_MAX_ESTIMATE, _MAX_ESTIMATE
        )
        mass_ratio = self._update_mass(estimate.mass_ratio, disturbance)
        bounded = np.abs(state).max(axis=1) < _MAX_ESTIMATE  # false for nan as well
        rigid = self.prediction.rigid(state, predicted.rigid[:, ROTOR_THRUST:])
        reference = measurement.reference
        updated = predicted._replace(
            state=state,
            disturbance=disturbance,
            reference=reference,
            rigid=rigid,
            mass_ratio=mass_ratio,
            innovation=np.where(np.isnan(innovation), 0.0, innovation),
        )
        # A delayed sensor repeats its first sample.
        valid = bounded & (updated.age > self.prediction.loop.sensor_delay)
        if valid.all():
            return updated
        initial = self.initial_estimate(measurement)._replace(age=np.where(bounded, updated.age, 0), loop=updated.loop)
        selected: Estimate = select_rows(valid, updated, initial)
        return selected

    def _update_mass(self, mass_ratio: Floats, disturbance: Floats) -> Floats:
        """Return μ̂ after equation (3), and change the vertical force in place."""
        if not self.gains.mass_time:
            return mass_ratio
        weight, force = self.simulation.parameters.hover_thrust, disturbance[:, FORCE + 2]
        share = -np.expm1(-self.simulation.period / self.gains.mass_time)
        updated: Floats = np.clip(mass_ratio - share * force / weight, *_MASS_RATIOS)
        force += (updated - mass_ratio) * weight
        return updated


@lru_cache(maxsize=32)
def gain_table(gains: EstimatorGains, simulation: Simulation, has_rates: bool) -> Floats:
    """Return L of equation (2) for the first 100 corrections; all later corrections use the last one.

    The shape is (100, 24, 16), or (100, 24, 8) without measured rates.
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
