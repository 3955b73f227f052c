"""Measurements: the state relative to the reference, and the reference, as an observation has them.

The horizontal part of the observed tracking error is that of the pole, so that the position of the vehicle is the error
less l r, with the length l that the controller assumes.
"""

from typing import Any

import numpy as np

from quadpend_baselines.estimation.estimate import (
    AGE,
    LOOP,
    MASS_RATIO,
    PLACE,
    POLE,
    REFERENCE,
    STATE,
    YAW,
    Estimate,
    law_inputs,
)
from quadpend_baselines.estimation.loop import READABLE, Loop
from quadpend_baselines.modelling.quantities import VehicleState, bob_offset, store_vectors
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.attitude import Quaternion, euler_from_rotation, normalised, rotation_matrix
from quadpend_gym.physics.state import DIRECTION as STATE_DIRECTION
from quadpend_gym.physics.state import EULER, POSITION
from quadpend_gym.physics.vectors import Vec3, load_four, store
from quadpend_gym.tasks.observation import (
    FULL,
    LAB,
    OBSERVATION_FIELDS,
    OBSERVATION_SCALE,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK_COLUMNS,
    REFERENCE_START,
    ObservationLayout,
)

_SCALE = LAB.scale
_POSITION, _QUATERNION, _LAB_DIRECTION, _AGE, _PLACE, _POLE = (
    LAB.columns[name].start for name in ("position", "quaternion", "direction", "age", "reference_0", "pole")
)
TRACKING_ERROR, _TRACKING_ERROR_RATE, DIRECTION, _DIRECTION_RATE, ATTITUDE, _EULER_RATE = (
    OBSERVATION_FIELDS[name].start
    for name in ("tracking_error", "tracking_error_rate", "direction", "direction_rate", "attitude", "euler_rate")
)


@inlined
def scaled_vector(observation: Any, place: int, field: int, lane: int) -> Vec3:
    """Return the vector that begins in row `place`, in the unit of the field that begins in column `field`."""
    x, y, z = observation[place, lane], observation[place + 1, lane], observation[place + 2, lane]
    return Vec3(x * OBSERVATION_SCALE[field], y * OBSERVATION_SCALE[field + 1], z * OBSERVATION_SCALE[field + 2])


@inlined
def measure_errors(observation: Any, lane: int, has_rates: bool, rod_length: float, out: Any) -> None:
    """Write the measured state, relative to the reference, and the reference; rates that are not measured are zero."""
    step = 6 if has_rates else 3
    none = Vec3(0.0, 0.0, 0.0)
    r = scaled_vector(observation, step, DIRECTION, lane)
    attitude = scaled_vector(observation, 2 * step, ATTITUDE, lane)
    error, error_rate, r_dot, euler_rate = scaled_vector(observation, 0, TRACKING_ERROR, lane), none, none, none
    if has_rates:
        error_rate = scaled_vector(observation, 3, _TRACKING_ERROR_RATE, lane)
        r_dot = scaled_vector(observation, 9, _DIRECTION_RATE, lane)
        euler_rate = scaled_vector(observation, 15, _EULER_RATE, lane)
    for i in range(MASS_RATIO - REFERENCE):
        out[REFERENCE + i, lane] = observation[3 * step + i, lane] * OBSERVATION_SCALE[REFERENCE_START + i]
    # The horizontal tracking error is that of the bob.
    position = Vec3(error.x - rod_length * r.x, error.y - rod_length * r.y, error.z)
    velocity = Vec3(error_rate.x - rod_length * r_dot.x, error_rate.y - rod_length * r_dot.y, error_rate.z)
    euler = Vec3(attitude.x, attitude.y, attitude.z + out[YAW, lane])
    store_vectors(out, STATE, lane, VehicleState(position, velocity, euler, euler_rate, r, r_dot))


@inlined
def measure_in_world(observation: Any, lane: int, rod_length: float, bob_mass: float, out: Any) -> None:
    """Write the state and the reference that the observation `LAB` has in the world, its age and the believed pole.

    The nominal length (m) and mass (kg) of the pole are subtracted.
    """
    for i in range(MASS_RATIO - PLACE):
        out[PLACE + i, lane] = _SCALE[_PLACE + i] * observation[_PLACE + i, lane]
    for i in range(3):
        out[STATE + POSITION + i, lane] = _SCALE[_POSITION + i] * observation[_POSITION + i, lane]
        out[STATE + STATE_DIRECTION + i, lane] = _SCALE[_LAB_DIRECTION + i] * observation[_LAB_DIRECTION + i, lane]
    q = load_four(observation, _QUATERNION, lane)
    rotation = rotation_matrix(normalised(Quaternion(q.a, q.b, q.c, q.d)))
    store(out, STATE + EULER, lane, euler_from_rotation(rotation, out[YAW, lane]))  # near the yaw of the reference
    out[AGE, lane] = _SCALE[_AGE] * observation[_AGE, lane]
    out[POLE, lane] = _SCALE[_POLE] * observation[_POLE, lane] - rod_length
    out[POLE + 1, lane] = _SCALE[_POLE + 1] * observation[_POLE + 1, lane] - bob_mass


@compiled
def _error_rows(observation: Floats, has_rates: bool, rod_length: float, out: Floats) -> None:
    for row in range(out.shape[0]):
        measure_errors(observation.T, row, has_rates, rod_length, out.T)


@compiled
def _world_rows(observation: Floats, rod_length: float, bob_mass: float, out: Floats) -> None:
    for row in range(out.shape[0]):
        measure_in_world(observation.T, row, rod_length, bob_mass, out.T)


def measurement_from_observation(
    observation: Floats32, rod_length: float, fields: ObservationLayout = FULL, bob_mass: float = 0.0
) -> Estimate:
    """Convert observations, shape (n, m), into measured states; nominal length (m) and mass (kg) of the pole.

    The fields are those of the observation; without velocities, rates are zero.
    """
    fields.check(observation)
    read = next(item for item in READABLE if set(item) <= set(fields))
    given, out = (
        np.ascontiguousarray(observation[:, fields.select(read)], np.float64),
        np.zeros((len(observation), LOOP)),
    )
    if read == LAB:
        _world_rows(given, rod_length, bob_mass, out)
    else:
        _error_rows(given, read == FULL, rod_length, out)
    return Estimate(out)


@inlined
def errors_of_estimate(estimate: Any, row: int, rod_length: float, out: Any) -> None:
    """Write the observation `FULL` of an estimate, with the tracked point of the believed pole."""
    s, _, _ = law_inputs(estimate, row)
    attitude = Vec3(s.euler.x, s.euler.y, s.euler.z - float(np.float32(estimate[row, YAW])))
    fields = (*bob_offset(s, rod_length), s.direction, s.direction_rate, attitude, s.euler_rate)
    for i in range(REFERENCE_START):
        out[row, i] = fields[i // 3][i % 3] / OBSERVATION_SCALE[i]
    for i in range(REFERENCE_START, OBSERVATION_SIZE):
        out[row, i] = estimate[row, REFERENCE - REFERENCE_START + i] / OBSERVATION_SCALE[i]


@compiled
def _observation_rows(estimate: Floats, rod_length: float, out: Floats32) -> None:
    for row in range(out.shape[0]):
        errors_of_estimate(estimate, row, rod_length, out)


def observation_of(estimate: Estimate, rod_length: float) -> Floats32:
    """Convert estimates into observations with velocities, the inverse of `measurement_from_observation`."""
    out = np.empty((len(estimate.array), OBSERVATION_SIZE), np.float32)
    _observation_rows(estimate.array, rod_length, out)
    return out


def errors_of(observation: Floats32, parameters: Parameters) -> Floats32:
    """Return the observation `OUTPUT_FEEDBACK` for observations `LAB`, with the error of the believed pole."""
    measured = measurement_from_observation(observation, parameters.rod_length, LAB, parameters.bob_mass)
    return observation_of(measured, parameters.rod_length)[:, OUTPUT_FEEDBACK_COLUMNS]


def observed_rows(
    observation: Floats32, loop: Loop, simulation: Simulation, before: Estimate | None, started: Booleans | None
) -> tuple[Booleans, tuple[Floats, bool, float]]:
    """Return which episodes begin, shape (n,), and what compiled functions need of the observation.

    These are the measurements, whether they have rates, and `doubts` of `samples.judge`. The arguments are those of
    `kalman.Estimator.observe`.
    """
    if started is None:
        started = np.full(len(observation), before is None)
    p = simulation.parameters
    measured = measurement_from_observation(observation, p.rod_length, loop.observation, p.bob_mass)
    return started, (measured.array, loop.has_rates, float(loop.in_world))
