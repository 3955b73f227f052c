"""An extended state observer that has the whole plant in it: the kernel predicts, a Kalman gain corrects.

    (1)  predict   x̂⁻ = f(x̂, u, d̂),          d̂⁻ = d̂                        f: one period of `kernel.advance`
    (2)  correct   x̂  = x̂⁻ + L_x (y − C x̂⁻),  d̂ = d̂⁻ + L_d (y − C x̂⁻)

Extended states are the forces on quadrotor and bob and the torque, which walk at random. (1) is nonlinear and exact; L
comes from the Kalman filter of `linear_model` (1), turned by the yaw angle. Its gain varies over the first steps of an
episode, when nothing is known of the forces and, in output feedback, of the rates, and is constant after.

Everything is relative to the reference, which accelerates: positions and velocities are those of a frame that moves
along with it, and the frame's own motion, a polynomial of order 6 over a period, is taken off after (1).
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
    MODEL_STATE_SIZE,
    PENDULUM,
    POSITION,
    STATE_COLUMNS,
    linearise,
    rotate_state,
)
from quadpend_baselines.modelling.planar import limit_norm, rotate
from quadpend_baselines.policy.protocol import select_rows
from quadpend_gym import Simulation, read_observation
from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE, State
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SCALE, OBSERVATION_SIZE, REFERENCE_START

_GAINS = 100  # steps after which the gain is constant
_FLATTEST = 0.95  # |r_xy| of an estimate at most: 72° from upright, where no episode is
_LARGEST = 300.0  # in SI units; an estimate with a larger number has lost its way and starts again
_HORIZONTAL_FORCES = (0, 3)  # where those on quadrotor and bob begin among the estimated forces
_POSITIONS = np.r_[POSITION, EULER, PENDULUM]  # what output feedback measures


class Measurement(NamedTuple):
    """An observation of n rows, as the estimator takes it."""

    state: Floats  # as `quadpend_gym.physics.state` has it, in the reference's frame; rates are nan where not measured, (n, 18)
    reference: Floats  # F_d⁽ⁱ⁾ for i = 2 … 6, (n, 5, 3)
    yaw_reference: Floats  # ψ_d, ψ̇_d, ψ̈_d, (n, 3)


class Estimate(NamedTuple):
    """What the estimator remembers, for n rows."""

    state: Floats  # x̂, as `Measurement.state` but known, (n, 18)
    disturbance: Floats  # d̂, as `kernel.advance` takes it, (n, 9)
    reference: Floats  # of the latest measurement, (n, 5, 3)
    age: Integers  # readings since the episode began, (n,)


def measurement_from_observation(observation: Floats32, rod_length: float) -> Measurement:
    """What an observation of n rows, shape (n, 36) or (n, 27), says."""
    direction = read_observation(observation, "direction")
    yaw_reference = read_observation(observation, "yaw_reference")
    state = np.full((observation.shape[0], STATE_SIZE), np.nan)
    s = State(state)
    horizontal = rod_length * np.array([1.0, 1.0, 0.0])  # the bob's position counts there
    s.direction[:] = direction
    s.position[:] = read_observation(observation, "tracking_error") - horizontal * direction
    s.euler[:] = read_observation(observation, "attitude")
    s.euler[:, 2] += yaw_reference[:, 0]
    if observation.shape[1] == OBSERVATION_SIZE:
        s.direction_rate[:] = read_observation(observation, "direction_rate")
        s.velocity[:] = read_observation(observation, "tracking_error_rate") - horizontal * s.direction_rate
        s.euler_rate[:] = read_observation(observation, "euler_rate")
    reference = np.stack([read_observation(observation, f"reference_{order}") for order in range(2, 7)], axis=1)
    return Measurement(state, reference, yaw_reference)


def observation_from_state(state: Floats, observation: Floats32, rod_length: float) -> Floats32:
    """The observation, shape (n, 36), of states in the reference's frame, (n, 18): what `read` would have read.

    Args:
        state: as `Measurement.state`.
        observation: measured at the same time, for the reference in it, shape (n, 36) or (n, 27).
        rod_length: m.
    """
    s, horizontal = State(state), rod_length * np.array([1.0, 1.0, 0.0])
    yaw_reference = read_observation(observation, "yaw_reference")[:, :1] * [0.0, 0.0, 1.0]
    out = np.empty((len(state), OBSERVATION_SIZE), np.float32)
    for name, value in {
        "tracking_error": s.position + horizontal * s.direction,
        "tracking_error_rate": s.velocity + horizontal * s.direction_rate,
        "direction": s.direction,
        "direction_rate": s.direction_rate,
        "attitude": s.euler - yaw_reference,
        "euler_rate": s.euler_rate,
    }.items():
        place = OBSERVATION_FIELDS[name]
        out[:, place] = value / OBSERVATION_SCALE[place]
    out[:, REFERENCE_START:] = observation[:, REFERENCE_START - OBSERVATION_SIZE :]
    return out


@dataclass(frozen=True)
class Estimator:
    """The observer (1)–(2) for one belief about plant and noise."""

    gains: EstimatorGains
    simulation: Simulation

    def initial_estimate(self, measurement: Measurement) -> Estimate:
        """Where the observer starts: what is measured; rates that are not, as the reference has them; no wind."""
        rows, p = len(measurement.state), self.simulation.parameters
        calm = np.zeros((rows, DISTURBANCE_SIZE))
        flight = flat_outputs.flat_trajectory(measurement.reference, calm, p)
        wanted, _ = flat_outputs.state_and_command(flight, measurement.yaw_reference, calm, p)
        state = np.where(np.isnan(measurement.state), wanted, measurement.state)
        _stand_up(state)
        return Estimate(state, calm, measurement.reference, np.zeros(rows, np.int64))

    def update(self, estimate: Estimate, command: Floats, measurement: Measurement) -> Estimate:
        """One period of equations (1)–(2), over which `command`, shape (n, 4), acted."""
        state, disturbance = self._predict(estimate, command), estimate.disturbance.copy()
        measured = ~np.isnan(measurement.state[0, 3])
        table = _gain_table(self.gains, self.simulation, bool(measured))
        gain = table[np.minimum(estimate.age, len(table) - 1)]
        seen = slice(None) if measured else _POSITIONS
        innovation = (measurement.state - state)[:, STATE_COLUMNS]
        yaw = state[:, 8].copy()
        correction = np.einsum("nij,nj->ni", gain, rotate_state(innovation, -yaw)[:, seen])
        state[:, STATE_COLUMNS] += rotate_state(correction[:, :MODEL_STATE_SIZE], yaw)
        disturbance[:, DISTURBANCE_COLUMNS] += rotate(correction[:, MODEL_STATE_SIZE:], yaw, *_HORIZONTAL_FORCES)
        _stand_up(state)
        disturbance[:, DISTURBANCE_COLUMNS] = np.clip(disturbance[:, DISTURBANCE_COLUMNS], -_LARGEST, _LARGEST)
        sane = np.abs(state).max(axis=1) < _LARGEST  # false for nan too
        later = Estimate(state, disturbance, measurement.reference, estimate.age + 1)
        return later if sane.all() else select_rows(sane, later, self.initial_estimate(measurement))

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


def _stand_up(state: Floats) -> None:
    """Put r on the upper half of the unit sphere, a little above its edge, and ṙ on its tangent plane."""
    s = State(state)
    s.direction[:, :2] = limit_norm(s.direction[:, :2], _FLATTEST)
    s.direction[:, 2] = np.sqrt(1.0 - np.sum(s.direction[:, :2] ** 2, axis=1))
    along = np.sum(s.direction[:, :2] * s.direction_rate[:, :2], axis=1)
    s.direction_rate[:, 2] = -along / s.direction[:, 2]


@lru_cache(maxsize=32)
def _gain_table(gains: EstimatorGains, simulation: Simulation, rates: bool) -> Floats:
    """L of equation (2) at the first and all later corrections, shape (100, 24, 16 or 8)."""
    model = linearise(simulation)
    size = MODEL_STATE_SIZE + DISTURBANCE_COLUMNS.size
    transition = np.eye(size)
    transition[:MODEL_STATE_SIZE, :MODEL_STATE_SIZE], transition[:MODEL_STATE_SIZE, MODEL_STATE_SIZE:] = (
        model.transition,
        model.disturbance,
    )
    walk = np.repeat([gains.force_walk, gains.bob_force_walk, gains.torque_walk], [3, 2, 3])
    process = np.zeros(size)
    process[MODEL_STATE_SIZE:] = walk**2 * simulation.period
    noise = np.empty(MODEL_STATE_SIZE)
    noise[_POSITIONS] = gains.noise**2
    is_rate = np.setdiff1d(np.arange(MODEL_STATE_SIZE), _POSITIONS)
    noise[is_rate] = gains.rate_noise**2
    rows = np.arange(MODEL_STATE_SIZE) if rates else _POSITIONS
    measure = np.eye(size)[rows]
    first = np.concatenate([noise, np.repeat([1.0, 0.1, 0.1], [3, 2, 3]) ** 2])
    if not rates:
        first[is_rate] = 0.1**2
    covariance = np.diag(first)
    table = []
    for _ in range(_GAINS):
        predicted = transition @ covariance @ transition.T + np.diag(process)
        gain = np.linalg.solve(measure @ predicted @ measure.T + np.diag(noise[rows]), measure @ predicted).T
        rest = np.eye(size) - gain @ measure
        covariance = rest @ predicted @ rest.T + gain @ np.diag(noise[rows]) @ gain.T
        table.append(gain)
    return np.array(table)
