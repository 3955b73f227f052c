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
from typing import Any

import numpy as np

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.estimation.prediction import (
    AGE,
    BUFFER_SIZE,
    DISTURBANCE,
    INNOVATION,
    LOOP,
    MASS_RATIO,
    ORDERS,
    REFERENCE,
    RIGID_PART,
    STATE,
    Estimate,
    Measurement,
    Part,
    PlantNumbers,
    Prediction,
    advance,
    load_action,
    project_direction,
    store_attitude,
    unpack_plant,
)
from quadpend_baselines.gains import EstimatorGains
from quadpend_baselines.modelling.equivalent import follow
from quadpend_baselines.modelling.linear_model import (
    EULER,
    MODEL_BOB_FORCE,
    MODEL_DISTURBANCE_SIZE,
    MODEL_FORCE,
    MODEL_STATE_SIZE,
    MODEL_TORQUE,
    PENDULUM,
    POSITION,
    linearise,
    model_state,
    state_of_model,
)
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    calm,
    combine,
    load_derivatives,
    load_forces,
    load_state,
    store_forces,
    store_reference,
    store_state,
    turn,
    turn3,
    with_rates,
)
from quadpend_gym import Simulation, read_observation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE, VELOCITY, State
from quadpend_gym.physics.vectors import Vec3, load, store, store_four
from quadpend_gym.tasks.observation import (
    OBSERVATION_FIELDS,
    OBSERVATION_SCALE,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK_SIZE,
    REFERENCE_START,
)

_TRACKING_ERROR, _TRACKING_ERROR_RATE, _DIRECTION, _DIRECTION_RATE, _ATTITUDE, _EULER_RATE = (
    OBSERVATION_FIELDS[name].start
    for name in ("tracking_error", "tracking_error_rate", "direction", "direction_rate", "attitude", "euler_rate")
)
_NAN = float("nan")
_VARYING_STEPS = 100  # corrections after which the gain is constant
_MAX_ESTIMATE = (
    300.0  # SI units, limit of disturbance estimates; rows with a larger state estimate restart the observer
)
_LEAST_MASS, _GREATEST_MASS = 0.5, 2.0  # bounds of μ̂
_FORCE, _BOB_FORCE, _TORQUE = (MODEL_STATE_SIZE + part.start for part in (MODEL_FORCE, MODEL_BOB_FORCE, MODEL_TORQUE))
_MEASURED_COLUMNS = np.r_[POSITION, EULER, PENDULUM]  # columns of x that output feedback measures
# Standard deviations of the estimates at the start of an episode
_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE = 1.0, 0.1, 0.1  # N, N, N·m
_INITIAL_RATE = 0.1  # of every rate that is not measured, SI units


@inlined
def scaled_vector(observation: Any, place: int, field: int, lane: int) -> Vec3:
    """Return the vector that begins in row `place`, in the unit of the field that begins in column `field`."""
    x, y, z = observation[place, lane], observation[place + 1, lane], observation[place + 2, lane]
    return Vec3(x * OBSERVATION_SCALE[field], y * OBSERVATION_SCALE[field + 1], z * OBSERVATION_SCALE[field + 2])


@inlined
def measure(observation: Any, lane: int, has_rates: bool, rod_length: float) -> tuple[VehicleState, Derivatives]:
    """Return the measured state, relative to the reference, and the reference; rates that are not measured are nan.

    Args:
        observation: Observations, shape (36, n), or (27, n) without rates.
        lane: Column.
        has_rates: Whether rates are measured.
        rod_length: l, m.
    """
    step = 6 if has_rates else 3
    none = Vec3(_NAN, _NAN, _NAN)
    r = scaled_vector(observation, step, _DIRECTION, lane)
    attitude = scaled_vector(observation, 2 * step, _ATTITUDE, lane)
    error, error_rate, r_dot, euler_rate = scaled_vector(observation, 0, _TRACKING_ERROR, lane), none, none, none
    if has_rates:
        error_rate = scaled_vector(observation, 3, _TRACKING_ERROR_RATE, lane)
        r_dot = scaled_vector(observation, 9, _DIRECTION_RATE, lane)
        euler_rate = scaled_vector(observation, 15, _EULER_RATE, lane)
    first = 3 * step
    reference = Derivatives(
        scaled_vector(observation, first, REFERENCE_START, lane),
        scaled_vector(observation, first + 3, REFERENCE_START + 3, lane),
        scaled_vector(observation, first + 6, REFERENCE_START + 6, lane),
        scaled_vector(observation, first + 9, REFERENCE_START + 9, lane),
        scaled_vector(observation, first + 12, REFERENCE_START + 12, lane),
        scaled_vector(observation, first + 15, REFERENCE_START + 15, lane),
    )
    # The horizontal tracking error is that of the bob.
    position = Vec3(error.x - rod_length * r.x, error.y - rod_length * r.y, error.z)
    velocity = Vec3(error_rate.x - rod_length * r_dot.x, error_rate.y - rod_length * r_dot.y, error_rate.z)
    euler = Vec3(attitude.x, attitude.y, attitude.z + reference.yaw.x)
    return VehicleState(position, velocity, euler, euler_rate, r, r_dot), reference


@compiled
def _measure_rows(observation: Floats32, rod_length: float, state: Floats, reference: Floats, yaw: Floats) -> None:
    has_rates, references = observation.shape[1] == OBSERVATION_SIZE, reference.reshape(len(reference), 3 * ORDERS)
    for row in range(observation.shape[0]):
        measured, wanted = measure(observation.T, row, has_rates, rod_length)
        store_state(state.T, 0, row, measured)
        store_reference(references.T, 0, row, wanted)
        store(yaw.T, 0, row, wanted.yaw)


def measurement_from_observation(observation: Floats32, rod_length: float) -> Measurement:
    """Convert observations, shape (n, 36), or (n, 27) without velocities, into a measurement; l in m."""
    rows, size = observation.shape
    if size not in (OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE):
        read_observation(observation, "direction")  # says which sizes there are
    out = Measurement(np.empty((rows, STATE_SIZE)), np.empty((rows, ORDERS, 3)), np.empty((rows, 3)))
    _measure_rows(np.ascontiguousarray(observation, np.float32), rod_length, *out)
    return out


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


@inlined
def begin(
    memory: Any,
    lane: int,
    measured: VehicleState,
    has_rates: bool,
    reference: Derivatives,
    plant: PlantNumbers,
    rigid: RigidSettings | None,
) -> None:
    """Write the estimate at the start of an episode; age and memory of the loop stay as they are.

    Rates that are not measured are those of the trajectory that follows the reference; the disturbance is zero.
    """
    desired, _ = follow(reference, calm(), plant.pendulum)
    state = project_direction(measured if has_rates else with_rates(measured, desired))
    for i in range(LOOP):
        memory[i, lane] = memory[i, lane] if i == AGE else 0.0
    store_state(memory, STATE, lane, state)
    store_reference(memory, REFERENCE, lane, reference)
    memory[MASS_RATIO, lane] = 1.0
    if rigid is not None:
        store_attitude(memory, RIGID_PART, lane, state)
        store_four(memory, RIGID_PART + ROTOR_THRUST, lane, rigid.rotors.hover)


@inlined
def correct(
    memory: Any,
    lane: int,
    measured: VehicleState,
    has_rates: bool,
    reference: Derivatives,
    gain: Any,
    mass_share: float,
    plant: PlantNumbers,
    rigid: RigidSettings | None,
    buffer: Any,
) -> None:
    """Correct a predicted estimate in place by equations (2) and (3).

    Args:
        memory: Estimates, shape (k, n).
        lane: Column.
        measured: The measured state.
        has_rates: Whether its rates are measured.
        reference: The reference of the measurement.
        gain: L, shape (24, 16).
        mass_share: ε of equation (3).
        plant: The vehicle.
        rigid: Settings of a rigid vehicle; None: the paper's vehicle.
        buffer: Buffer, shape (24, 1) or longer.
    """
    predicted = load_state(memory, STATE, lane)
    innovation = combine(-1.0, predicted, measured if has_rates else with_rates(measured, predicted))
    store_state(memory, INNOVATION, lane, innovation)
    sine, cosine = sincos(predicted.euler.z)
    x = model_state(innovation, -sine, cosine)
    for i in range(gain.shape[0]):
        total = 0.0
        for j in range(MODEL_STATE_SIZE):
            total += gain[i, j] * x[j]
        buffer[i, 0] = total
    state = project_direction(combine(1.0, state_of_model(buffer, sine, cosine), predicted))
    store_state(memory, STATE, lane, state)
    force, bob_force = turn3(load(buffer, _FORCE, 0), sine, cosine), turn(load(buffer, _BOB_FORCE, 0), sine, cosine)
    torque = load(buffer, _TORQUE, 0)
    if rigid is not None:  # a vector of the world frame
        torque = turn3(torque, sine, cosine)
    d = load_forces(memory, DISTURBANCE, lane)
    force_z, ratio = _bounded(d.force.z + force.z), memory[MASS_RATIO, lane]
    p = plant.pendulum.vehicle
    weight = (p.quadrotor_mass + p.bob_mass) * p.gravity
    memory[MASS_RATIO, lane] = min(max(ratio - mass_share * force_z / weight, _LEAST_MASS), _GREATEST_MASS)
    force_z += (memory[MASS_RATIO, lane] - ratio) * weight
    forces = Forces(
        Vec3(_bounded(d.force.x + force.x), _bounded(d.force.y + force.y), force_z),
        Vec3(_bounded(d.bob_force.x + bob_force.x), _bounded(d.bob_force.y + bob_force.y), d.bob_force.z),
        Vec3(_bounded(d.torque.x + torque.x), _bounded(d.torque.y + torque.y), _bounded(d.torque.z + torque.z)),
    )
    store_forces(memory, DISTURBANCE, lane, forces)
    store_reference(memory, REFERENCE, lane, reference)
    if rigid is not None:
        store_attitude(memory, RIGID_PART, lane, state)


@inlined
def _bounded(value: float) -> float:
    return min(max(value, -_MAX_ESTIMATE), _MAX_ESTIMATE)


@inlined
def _is_bounded(memory: Any, lane: int) -> bool:
    """Return whether a state is small enough; false for nan as well."""
    out = True
    for i in range(STATE_SIZE):
        out = out and abs(memory[i, lane]) < _MAX_ESTIMATE
    return out


@compiled
def _observe(
    last: Any, measurement: Measurement, table: Floats, mass_share: float, loop: Any, packed_rigid: Any, out: Floats
) -> None:
    (before, action, started), (parts, actuators, packed_plant) = last, loop
    plant, rigid = unpack_plant(packed_plant), None if packed_rigid is None else unpack_rigid(packed_rigid)
    buffer, memory = np.empty((BUFFER_SIZE, 1)), out.T
    period = Part(parts[0, 0], parts[0, 1], parts[0, 2])
    for row in range(out.shape[0]):
        measured = load_state(measurement.state.T, 0, row)
        wanted = load_derivatives(measurement.reference[row], load(measurement.yaw_reference.T, 0, row))
        has_rates = not np.isnan(measured.velocity.x)
        if started[row]:
            out[row] = 0.0
            begin(memory, row, measured, has_rates, wanted, plant, rigid)
            continue
        out[row] = before[row]
        gain = table[min(int(before[row, AGE]), table.shape[0] - 1)]
        advance(memory, row, load_action(action, row), period, actuators[0], plant, rigid, buffer)
        correct(memory, row, measured, has_rates, wanted, gain, mass_share, plant, rigid, buffer)
        is_bounded = _is_bounded(memory, row)
        # A delayed sensor repeats its first sample.
        if not (is_bounded and out[row, AGE] > plant.sensor_delay):
            out[row, AGE] = out[row, AGE] if is_bounded else 0.0
            begin(memory, row, measured, has_rates, wanted, plant, rigid)


@dataclass(frozen=True)
class Estimator:
    """The observer (1)–(3) for n rows."""

    gains: EstimatorGains  # noise levels of the Kalman filter
    simulation: Simulation  # nominal plant and control period
    loop: Loop = field(default_factory=Loop)  # the known part of the loop; it is left out if `gains.predicts` is False

    @cached_property
    def prediction(self) -> Prediction:
        """The prediction (1)."""
        return Prediction(self.simulation, self.loop if self.gains.predicts else Loop(), self.gains.predicts)

    @property
    def size(self) -> int:
        """Length of an estimate."""
        return LOOP + self.prediction.loop_size

    @cached_property
    def numbers(self) -> tuple[float, Any, Floats | None]:
        """ε, and the numbers of the prediction."""
        time = self.gains.mass_time
        return float(-np.expm1(-self.simulation.period / time)) if time else 0.0, *self.prediction.numbers

    @cached_property
    def _tables(self) -> tuple[Floats, Floats]:
        """The gains without and with measured rates."""
        return tuple(gain_table(self.gains, self.simulation, has_rates) for has_rates in (False, True))  # type: ignore[return-value]

    def observe(
        self,
        measurement: Measurement,
        before: Estimate | None = None,
        action: Floats32 | None = None,
        started: Booleans | None = None,
    ) -> Estimate:
        """Return the estimates after a measurement.

        Args:
            measurement: The measurement.
            before: The estimates one period ago; None: the episodes begin with this measurement.
            action: The actions since then, shape (n, 4).
            started: The rows whose episode begins with this measurement, shape (n,); None: none of them.
        """
        rows = len(measurement.state)
        out = np.empty((rows, self.size))
        if before is None or action is None:
            before, action, started = Estimate(out), np.empty((rows, ACTION_SIZE), np.float32), np.ones(rows, np.bool_)
        elif started is None:
            started = np.zeros(rows, np.bool_)
        table = self._tables[not np.isnan(measurement.state[0, VELOCITY])]
        _observe((before.array, action, started), measurement, table, *self.numbers, out)
        return Estimate(out)


@lru_cache(maxsize=32)
def gain_table(gains: EstimatorGains, simulation: Simulation, has_rates: bool) -> Floats:
    """Return L of equation (2) for the first 100 corrections; all later corrections use the last one.

    The shape is (100, 24, 16); columns of rates that are not measured are zero.
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
    table = np.zeros((_VARYING_STEPS, size, MODEL_STATE_SIZE))
    for step in range(_VARYING_STEPS):
        predicted = transition @ covariance @ transition.T + np.diag(process)
        gain = np.linalg.solve(output @ predicted @ output.T + np.diag(noise[measured]), output @ predicted).T
        error_transition = np.eye(size) - gain @ output
        covariance = error_transition @ predicted @ error_transition.T + gain @ np.diag(noise[measured]) @ gain.T
        table[step][:, measured] = gain
    return table


def _model_disturbance(force: float, bob_force: float, torque: float) -> Floats:
    """Return one number per component of d in `linear_model`, shape (8,)."""
    out = np.empty(MODEL_DISTURBANCE_SIZE)
    out[MODEL_FORCE], out[MODEL_BOB_FORCE], out[MODEL_TORQUE] = force, bob_force, torque
    return out
