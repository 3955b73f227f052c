"""Extended state observer of the whole plant: prediction with the nonlinear simulation, correction with a Kalman gain.

    (1)  predict   x̂⁻ = f(x̂, ā, d̂, μ̂),      d̂⁻ = d̂,   ā_k = h(a_k, a_{k−1}, …)     f: one control period, h: `loop.act`
    (2)  correct   x̂  = x̂⁻ + L_x (y − C x̂⁻),  d̂ = d̂⁻ + L_d (y − C x̂⁻)
    (3)  weight    μ̂ ← μ̂ − ε d̂_z/((M + m) g),   d̂_z ← (1 − ε) d̂_z          ε = 1 − e^(−T/mass_time)

The extended states d are the forces on quadrotor and bob and the torque, modelled as random walks. The prediction (1)
is that of the simulation itself, with nominal parameters. L is the gain of the Kalman filter for model (1) of
`linear_model`, rotated by the yaw angle; the torque on a rigid vehicle is a vector of the world frame. The gain varies
over the first steps of an episode, when the forces and, in output feedback, the rates are unknown; after that it is
constant, or with `gust_walk`

    (4)  L = L_calm + s (L_gust − L_calm),     s = min(|d̂_b|²/(0.02 m_b g)², 1)

where d̂_b is the horizontal force on the bob that was estimated before. In turbulence this force fluctuates. Where only
the vehicle is pushed, a filter that expects such fluctuations amplifies the noise of the direction. Drag and constant
wind on the bob raise s too. Between both gains, L is the gain of no Kalman filter, and stability is not proven.

μ̂ is an effective ratio of weight to thrust, relative to the nominal one. Equation (3) attributes every lasting vertical
force to it: other masses, but also slow vertical wind and errors of the thrust. At hover these cannot be distinguished,
but a law that takes the weight of a heavy vehicle for a downward wind overestimates the effect of the tilt on the
pendulum. μ̂ scales the masses of quadrotor and pole, but not the moments of inertia.

While a pendulum with measured rates is more than 72° from upright, x̂ is the measurement; d̂ is still corrected with the
gain of an upright pendulum.

Positions and velocities are relative to the reference, which accelerates. The prediction therefore subtracts the motion
of the reference over a period, a polynomial of order 6. The state of a rigid vehicle includes the thrusts of its
rotors, which are predicted without correction; f delays the action by the latency of the simulation.

An estimate is a flat vector with this layout (`Estimate` names its parts):

| fields | name          | content                                                                                    |
|--------|---------------|--------------------------------------------------------------------------------------------|
| 0–17   | `state`       | x̂ as in `quadpend_gym.physics.state`; position and velocity are relative to the reference  |
| 18–26  | `disturbance` | d̂, laid out as `Disturbance`, N and N·m                                                    |
| 27–41  | `reference`   | F_d⁽ⁱ⁾ for i = 2 … 6 of the latest measurement                                             |
| 42–44  | `yaw`         | its ψ_d, ψ̇_d, ψ̈_d in rad, rad/s, rad/s²                                                    |
| 45     | `mass_ratio`  | μ̂, effective ratio of weight to thrust, which scales the masses of quadrotor and bob      |
| 46     | `age`         | number of corrections since the episode began                                              |
| 47–64  | `innovation`  | measured minus predicted state before the latest correction; 0 for rates not measured      |
| 65–75  | `rigid`       | quaternion, body rate and rotor thrusts of a rigid vehicle, see `physics.rigid_kernel`     |
| 76–    |               | memory of the known loop, see `loop.act`; with a latency that is not a whole number of     |
|        |               | periods then the action before                                                             |
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.loop import Loop, act, compensate
from quadpend_baselines.gains import EstimatorGains
from quadpend_baselines.modelling import linear_model
from quadpend_baselines.modelling.equivalent import Pendulum, equivalent_model, follow
from quadpend_baselines.modelling.linear_model import (
    MODEL_STATE_SIZE,
    linearise,
    linearise_actions,
    model_state,
    state_of_model,
)
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    bob_offset,
    calm,
    combine,
    load_forces,
    load_reference,
    load_state,
    store_vectors,
    turn3,
    with_rates,
)
from quadpend_gym import Parameters, Simulation, read_observation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.attitude import body_rate, quaternion_from_euler
from quadpend_gym.physics.euler_kernel import integrate_euler
from quadpend_gym.physics.rigid_kernel import (
    BODY_RATE,
    QUATERNION,
    RIGID,
    RIGID_LANE_SIZE,
    RIGID_SIZE,
    ROTOR_THRUST,
    integrate_rigid,
)
from quadpend_gym.physics.rigid_settings import RigidSettings, nominal_loop, unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, POSITION, STATE_SIZE, VELOCITY
from quadpend_gym.physics.vectors import Four, Vec3, load, store, store_four
from quadpend_gym.tasks.observation import (
    OBSERVATION_FIELDS,
    OBSERVATION_SCALE,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK_SIZE,
    REFERENCE_START,
)
from quadpend_gym.vehicles.parameters import BOB_MASS, PARAMETERS_SIZE, QUADROTOR_MASS

_MAX_HORIZONTAL = 0.95  # bound of |r_xy| of an estimate: 72° from upright; the default limit of an episode is 60°
_LEAST_HEIGHT = float(np.sqrt(1.0 - _MAX_HORIZONTAL**2))  # r_z there
ORDERS = 5  # derivatives of the reference, of order 2 … 6
STATE, DISTURBANCE, REFERENCE, YAW, MASS_RATIO, AGE, INNOVATION, RIGID_PART, LOOP = 0, 18, 27, 42, 45, 46, 47, 65, 76
# Fields of the buffer in which an estimate is advanced: the lanes of the kernels, parameters, the action before and
# this one, disturbance, velocity of the air, and command.
_PARAMETERS = RIGID_LANE_SIZE
_BEFORE = _PARAMETERS + PARAMETERS_SIZE
_ACTION = _BEFORE + ACTION_SIZE
_FORCES = _ACTION + ACTION_SIZE
_AIR = _FORCES + DISTURBANCE_SIZE
_COMMAND = _AIR + 3
BUFFER_SIZE = _COMMAND + ACTION_SIZE
TRACKING_ERROR, _TRACKING_ERROR_RATE, DIRECTION, _DIRECTION_RATE, ATTITUDE, _EULER_RATE = (
    OBSERVATION_FIELDS[name].start
    for name in ("tracking_error", "tracking_error_rate", "direction", "direction_rate", "attitude", "euler_rate")
)
_NAN = float("nan")
_VARYING_STEPS = 100  # corrections after which the gain is constant
_MAX_ESTIMATE = 300.0  # SI units, limit of disturbance estimates; a larger state estimate restarts the observer
_LEAST_MASS, _GREATEST_MASS = 0.5, 2.0  # bounds of μ̂
_GUST = 0.02  # force on the bob above which equation (4) has the gain of strong wind, share of its weight
_MODEL_PARTS = linear_model.MODEL_FORCE, linear_model.MODEL_BOB_FORCE, linear_model.MODEL_TORQUE
_FORCE, _BOB_FORCE, _TORQUE = (MODEL_STATE_SIZE + part.start for part in _MODEL_PARTS)
# Columns of x that output feedback measures
_MEASURED_COLUMNS = np.r_[linear_model.POSITION, linear_model.EULER, linear_model.PENDULUM]
# Standard deviations of the estimates at the start of an episode
_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE = 1.0, 0.1, 0.1  # N, N, N·m
_INITIAL_RATE = 0.1  # of every rate that is not measured, SI units


class _Part:
    """Fields of every estimate in an array, as a view."""

    def __init__(self, first: int, end: int) -> None:
        self.part = slice(first, end)

    def __get__(self, instance: Any, owner: type) -> Floats:
        view: Floats = instance.array[:, self.part]
        return view


class _Rows(NamedTuple):
    array: Floats  # shape (n, k)


class Estimate(_Rows):
    """Named views of n estimates, see the table above; writing into a view writes into the array.

    Exact measurements have the same layout; their other fields are 0, and rates that are not measured are nan.
    """

    state = _Part(STATE, DISTURBANCE)
    disturbance = _Part(DISTURBANCE, REFERENCE)
    yaw = _Part(YAW, MASS_RATIO)
    mass_ratio = _Part(MASS_RATIO, AGE)  # shape (n, 1)
    innovation = _Part(INNOVATION, RIGID_PART)
    rigid = _Part(RIGID_PART, LOOP)

    @property
    def reference(self) -> Floats:
        """Return the reference, shape (n, 5, 3)."""
        return self.array[:, REFERENCE:YAW].reshape(-1, ORDERS, 3)


class PlantNumbers(NamedTuple):
    """The vehicle and its known loop inside compiled functions."""

    pendulum: Pendulum
    quadrotor_drag_area: float  # m²
    bob_drag_area: float  # m²
    command_scale: Four  # see `Simulation.command_scale`
    delay: int  # periods from the choice of an action until it acts
    sensor_delay: int  # those among them that delay the measurement


class LoopNumbers(NamedTuple):
    """The vehicle and the parts of a known loop by which an estimate advances in turn, see `Prediction`."""

    parts: Any  # length (s) and substeps, shape (k, 2)
    ages: Any  # of the action that acts in each substep, see `euler_kernel.acting`, shape (k, s, 1)
    nominal: Any  # numbers of the loop, see `rigid_settings.nominal_loop`, shape (7, 1)
    actuators: Any  # `Loop.numbers` of each part, shape (k, m, 4)
    plant: PlantNumbers


unpack_plant = unpacker(PlantNumbers)


@inlined
def unpack_loop(packed: Any) -> LoopNumbers:
    """Return the numbers that `Prediction.numbers` has packed."""
    return LoopNumbers(packed[0], packed[1], packed[2], packed[3], unpack_plant(packed[4]))


@inlined
def project_direction(s: VehicleState) -> VehicleState:
    """Return the state with |r_xy| limited, and with r_z and ṙ_z such that |r| = 1, r_z > 0 and r·ṙ = 0."""
    r, r_dot = s.direction, s.direction_rate
    share = _MAX_HORIZONTAL / max(np.sqrt(r.x * r.x + r.y * r.y), _MAX_HORIZONTAL)
    x, y = share * r.x, share * r.y
    z = np.sqrt(1.0 - (x * x + y * y))
    rate = Vec3(r_dot.x, r_dot.y, -(x * r_dot.x + y * r_dot.y) / z)
    return VehicleState(s.position, s.velocity, s.euler, s.euler_rate, Vec3(x, y, z), rate)


@inlined
def store_attitude(memory: Any, first: int, lane: int, state: VehicleState) -> None:
    """Write quaternion and body rate of a state into the part of a rigid vehicle, which begins with field `first`."""
    store_four(memory, first + QUATERNION, lane, quaternion_from_euler(state.euler))
    store(memory, first + BODY_RATE, lane, body_rate(state.euler, state.euler_rate))


@inlined
def _move_reference(memory: Any, lane: int, t: float) -> None:
    """Subtract the motion of the reference over a time t (s) from position and velocity, and advance the reference."""
    for axis in range(3):
        first = REFERENCE + axis
        a, b, c = memory[first, lane], memory[first + 3, lane], memory[first + 6, lane]
        d, e = memory[first + 9, lane], memory[first + 12, lane]
        shift = t * t / 2.0 * (a + t / 3.0 * (b + t / 4.0 * (c + t / 5.0 * (d + t / 6.0 * e))))
        memory[POSITION + axis, lane] -= shift
        memory[VELOCITY + axis, lane] -= t * (a + t / 2.0 * (b + t / 3.0 * (c + t / 4.0 * (d + t / 5.0 * e))))
        memory[first, lane] = a + t * (b + t / 2.0 * (c + t / 3.0 * (d + t / 4.0 * e)))
        memory[first + 3, lane] = b + t * (c + t / 2.0 * (d + t / 3.0 * e))
        memory[first + 6, lane] = c + t * (d + t / 2.0 * e)
        memory[first + 9, lane] = d + t * e


@inlined
def advance(
    memory: Any, lane: int, action: Four, k: int, loop: LoopNumbers, rigid: RigidSettings | None, buffer: Any
) -> None:
    """Advance an estimate in place by equation (1) over part k of the loop, without a correction.

    Its reference moves along. The buffer has the shape (BUFFER_SIZE, 1).
    """
    plant, actuators = loop.plant, loop.actuators[k]
    period, substeps, ages = loop.parts[k, 0], int(loop.parts[k, 1]), loop.ages[k]
    issued, acting, command = buffer[_BEFORE:_FORCES], buffer[_ACTION:_FORCES], buffer[_COMMAND:BUFFER_SIZE]
    store_four(acting, 0, 0, action)
    act(acting, plant.delay, actuators, memory, LOOP, lane)
    last = LOOP + ACTION_SIZE * (plant.delay + actuators.shape[0])
    if ages[0, 0] > 0:
        for i in range(ACTION_SIZE):
            issued[i, 0], memory[last + i, lane] = memory[last + i, lane], acting[i, 0]
    for i in range(STATE_SIZE):
        buffer[i, 0] = memory[i, lane]
    for i in range(DISTURBANCE_SIZE):
        buffer[_FORCES + i, 0] = memory[DISTURBANCE + i, lane]
    p = plant.pendulum.vehicle
    for i in range(PARAMETERS_SIZE - 2):
        buffer[_PARAMETERS + i, 0] = p[i]
    buffer[_PARAMETERS + QUADROTOR_MASS, 0] = memory[MASS_RATIO, lane] * p.quadrotor_mass
    buffer[_PARAMETERS + BOB_MASS, 0] = memory[MASS_RATIO, lane] * p.bob_mass
    buffer[_PARAMETERS + PARAMETERS_SIZE - 2, 0] = plant.quadrotor_drag_area
    buffer[_PARAMETERS + PARAMETERS_SIZE - 1, 0] = plant.bob_drag_area
    lanes, parameters, forces = buffer[:_PARAMETERS], buffer[_PARAMETERS:_BEFORE], buffer[_FORCES:_AIR]
    if rigid is None:
        scale, numbers = plant.command_scale, loop.nominal
        integrate_euler(lanes, issued, ages, numbers, forces, parameters, scale, 1, period, substeps, command)
    else:
        for i in range(RIGID_SIZE):
            buffer[RIGID + i, 0] = memory[RIGID_PART + i, lane]
        air, numbers = buffer[_AIR:_COMMAND], loop.nominal
        store(air, 0, 0, Vec3(0.0, 0.0, 0.0))
        integrate_rigid(lanes, issued, ages, numbers, forces, air, parameters, rigid, 1, period, substeps, command)
        for i in range(RIGID_SIZE):
            memory[RIGID_PART + i, lane] = buffer[RIGID + i, 0]
    for i in range(STATE_SIZE):
        memory[i, lane] = buffer[i, 0]
    _move_reference(memory, lane, period)
    memory[AGE, lane] += 1.0


@inlined
def carry_forward(
    memory: Any, lane: int, action: Four, loop: LoopNumbers, rigid: RigidSettings | None, buffer: Any
) -> None:
    """Advance an estimate in place to the time when the next action acts.

    The latest action that the controller has chosen is taken to continue while a lag of the actuators is predicted
    through.
    """
    time, yaw = 0.0, load(memory, YAW, lane)
    for k in range(1, loop.parts.shape[0]):
        advance(memory, lane, action, k, loop, rigid, buffer)
        time += loop.parts[k, 0]
    store_vectors(memory, STATE, lane, project_direction(load_state(memory, STATE, lane)))
    store(memory, YAW, lane, Vec3(yaw.x + time * (yaw.y + time / 2.0 * yaw.z), yaw.y + time * yaw.z, yaw.z))


@inlined
def law_inputs(estimate: Any, row: int) -> tuple[VehicleState, Forces, Derivatives]:
    """Return state, disturbance and reference of an estimate."""
    lanes = estimate.T
    return load_state(lanes, STATE, row), load_forces(lanes, DISTURBANCE, row), load_reference(lanes, REFERENCE, row)


@inlined
def load_action(action: Any, row: int) -> Four:
    """Return an action of n rows, shape (n, 4), in double precision."""
    a = action[row]
    return Four(float(a[0]), float(a[1]), float(a[2]), float(a[3]))


@compiled
def _carry(estimate: Floats, action: Floats32, packed: Any, packed_rigid: Floats | None) -> None:
    loop, buffer = unpack_loop(packed), np.empty((BUFFER_SIZE, 1))
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(estimate.shape[0]):
        carry_forward(estimate.T, row, load_action(action, row), loop, rigid, buffer)


@compiled
def _compensate(action: Floats, delay: int, actuators: Floats, memory: Floats) -> None:
    for row in range(action.shape[0]):
        compensate(action.T, delay, actuators, memory.T, LOOP, row)


@dataclass(frozen=True)
class Prediction:
    """Equation (1) for n rows."""

    simulation: Simulation  # nominal plant and control period
    known_loop: Loop  # the known part of the loop, without the latency of the simulation
    predicts_latency: bool = True  # whether the latency is known

    @cached_property
    def loop(self) -> Loop:
        """The known part of the loop, with the whole periods of the latency."""
        return replace(self.known_loop, delay=self.known_loop.delay + self._latency[0])

    @cached_property
    def _latency(self) -> tuple[int, int]:
        """The latency in whole control periods and the remaining substeps."""
        delayed = self.simulation.delayed_substeps if self.predicts_latency else 0
        return delayed // self.simulation.substeps, delayed % self.simulation.substeps

    @cached_property
    def loop_size(self) -> int:
        """Length of the memory of the known loop, with the last action if it is needed."""
        return ACTION_SIZE * (self.loop.steps + len(self.loop.actuators) + (self._latency[1] > 0))

    @cached_property
    def parts(self) -> Floats:
        """The control period, and the periods and parts of one until the next action acts: s and substeps, (k, 2)."""
        substeps, switch = self.simulation.substeps, self._latency[1]
        substep = self.simulation.period / substeps
        numbers = [substeps] * (1 + self.loop.steps)
        rest = switch + round(self.loop.lag / substep)
        while rest > 0:
            numbers.append(min(rest, substeps))
            rest -= numbers[-1]
        return np.array([[n * substep if n < substeps else self.simulation.period, n] for n in numbers])

    @cached_property
    def actuators(self) -> Floats:
        """The actuators in each of the parts, shape (k, m, 4)."""
        return np.array([self.loop.numbers(period) for period in self.parts[:, 0]])

    @cached_property
    def numbers(self) -> tuple[Any, Floats | None]:
        """What compiled functions need: packed `LoopNumbers`, and packed settings of a rigid vehicle."""
        model, p, scale = equivalent_model(self.simulation), self.simulation.parameters, self.simulation.command_scale
        areas, loop = (p.quadrotor_drag_area, p.bob_drag_area), self.loop
        plant = PlantNumbers(model.numbers, *areas, Four(*scale.tolist()), loop.steps, loop.sensor_delay)
        begins = np.arange(self.simulation.substeps) < self._latency[1]  # with the action before
        ages = np.tile(begins.astype(np.int16)[:, np.newaxis], (len(self.parts), 1, 1))
        nominal = nominal_loop(self.simulation)[:, np.newaxis]
        return (self.parts, ages, nominal, self.actuators, pack(plant)), model.packed_rigid

    def compensate(self, wanted: Floats32, estimate: Floats) -> Floats32:
        """Return the actions that compensate the lags of the loop, shape (n, 4), see `loop.compensate`.

        The estimate, shape (n, k), is that of the time when the action acts.
        """
        if not self.actuators[0, :, 3].any():
            return wanted
        out = wanted.astype(np.float64)
        _compensate(out, self.loop.steps, self.actuators[0], estimate)
        return out.astype(np.float32)

    def carry_forward(self, estimate: Estimate, action: Floats32) -> Estimate:
        """Return the estimate at the time when the next action acts.

        `action` is the latest one that the controller has chosen, shape (n, 4).
        """
        if len(self.parts) == 1:
            return estimate
        then = Estimate(estimate.array.copy())
        _carry(then.array, action, *self.numbers)
        return then


@inlined
def scaled_vector(observation: Any, place: int, field: int, lane: int) -> Vec3:
    """Return the vector that begins in row `place`, in the unit of the field that begins in column `field`."""
    x, y, z = observation[place, lane], observation[place + 1, lane], observation[place + 2, lane]
    return Vec3(x * OBSERVATION_SCALE[field], y * OBSERVATION_SCALE[field + 1], z * OBSERVATION_SCALE[field + 2])


@inlined
def read_reference(observation: Any, place: int, lane: int) -> Derivatives:
    """Return the reference in an observation, which begins in row `place`."""
    return Derivatives(
        scaled_vector(observation, place, REFERENCE_START, lane),
        scaled_vector(observation, place + 3, REFERENCE_START + 3, lane),
        scaled_vector(observation, place + 6, REFERENCE_START + 6, lane),
        scaled_vector(observation, place + 9, REFERENCE_START + 9, lane),
        scaled_vector(observation, place + 12, REFERENCE_START + 12, lane),
        scaled_vector(observation, place + 15, REFERENCE_START + 15, lane),
    )


@inlined
def measure(observation: Any, lane: int, has_rates: bool, rod_length: float) -> tuple[VehicleState, Derivatives]:
    """Return the measured state, relative to the reference, and the reference; rates that are not measured are nan."""
    step = 6 if has_rates else 3
    none = Vec3(_NAN, _NAN, _NAN)
    r = scaled_vector(observation, step, DIRECTION, lane)
    attitude = scaled_vector(observation, 2 * step, ATTITUDE, lane)
    error, error_rate, r_dot, euler_rate = scaled_vector(observation, 0, TRACKING_ERROR, lane), none, none, none
    if has_rates:
        error_rate = scaled_vector(observation, 3, _TRACKING_ERROR_RATE, lane)
        r_dot = scaled_vector(observation, 9, _DIRECTION_RATE, lane)
        euler_rate = scaled_vector(observation, 15, _EULER_RATE, lane)
    reference = read_reference(observation, 3 * step, lane)
    # The horizontal tracking error is that of the bob.
    position = Vec3(error.x - rod_length * r.x, error.y - rod_length * r.y, error.z)
    velocity = Vec3(error_rate.x - rod_length * r_dot.x, error_rate.y - rod_length * r_dot.y, error_rate.z)
    euler = Vec3(attitude.x, attitude.y, attitude.z + reference.yaw.x)
    return VehicleState(position, velocity, euler, euler_rate, r, r_dot), reference


@compiled
def _measure_rows(observation: Floats32, rod_length: float, out: Floats) -> None:
    has_rates = observation.shape[1] == OBSERVATION_SIZE
    for row in range(out.shape[0]):
        state, reference = measure(observation.T, row, has_rates, rod_length)
        store_vectors(out.T, STATE, row, state)
        store_vectors(out.T, REFERENCE, row, reference)


def measurement_from_observation(observation: Floats32, rod_length: float) -> Estimate:
    """Convert observations, shape (n, 36), or (n, 27) without velocities, into measured states; l in m."""
    rows, size = observation.shape
    if size not in (OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE):
        read_observation(observation, "direction")  # says which sizes there are
    out = np.zeros((rows, LOOP))
    _measure_rows(np.ascontiguousarray(observation, np.float32), rod_length, out)
    return Estimate(out)


@compiled
def _observation_rows(estimate: Floats, rod_length: float, out: Floats32) -> None:
    for row in range(out.shape[0]):
        s = load_state(estimate.T, STATE, row)
        attitude = Vec3(s.euler.x, s.euler.y, s.euler.z - float(np.float32(estimate[row, YAW])))
        fields = (*bob_offset(s, rod_length), s.direction, s.direction_rate, attitude, s.euler_rate)
        for i in range(REFERENCE_START):
            out[row, i] = fields[i // 3][i % 3] / OBSERVATION_SCALE[i]
        for i in range(REFERENCE_START, OBSERVATION_SIZE):
            out[row, i] = estimate[row, REFERENCE - REFERENCE_START + i] / OBSERVATION_SCALE[i]


def observation_of(estimate: Estimate, rod_length: float) -> Floats32:
    """Convert estimates into observations with velocities, the inverse of `measurement_from_observation`."""
    out = np.empty((len(estimate.array), OBSERVATION_SIZE), np.float32)
    _observation_rows(estimate.array, rod_length, out)
    return out


@inlined
def begin(
    memory: Any,
    lane: int,
    measured: VehicleState,
    has_rates: bool,
    reference: Derivatives,
    model: Pendulum,
    rigid: RigidSettings | None,
) -> None:
    """Write the estimate at the start of an episode; age and memory of the loop stay as they are.

    Rates that are not measured are those of the trajectory that follows the reference; the disturbance is zero.
    """
    desired, _ = follow(reference, calm(), model)
    state = project_direction(measured if has_rates else with_rates(measured, desired))
    for i in range(LOOP):
        memory[i, lane] = memory[i, lane] if i == AGE else 0.0
    store_vectors(memory, STATE, lane, state)
    store_vectors(memory, REFERENCE, lane, reference)
    memory[MASS_RATIO, lane] = 1.0
    if rigid is not None:
        store_attitude(memory, RIGID_PART, lane, state)
        store_four(memory, RIGID_PART + ROTOR_THRUST, lane, rigid.rotors.hover)


@inlined
def _corrected(gain: Any, row: int, first: int, x: Any) -> float:
    """Return the product of a row of a gain, which begins with column `first`, and an innovation."""
    total = 0.0
    for j in range(MODEL_STATE_SIZE):
        total += gain[row, first + j] * x[j]
    return total


@inlined
def correct(
    memory: Any,
    lane: int,
    measured: VehicleState,
    has_rates: bool,
    reference: Derivatives,
    gain: Any,
    mass_share: float,
    p: Parameters,
    rigid: RigidSettings | None,
    buffer: Any,
) -> None:
    """Correct a predicted estimate in place by equations (2) and (3).

    The gain L has the shape (24, 16), or (24, 32) with L_gust − L_calm of equation (4) behind L_calm. The buffer has at
    least the shape (24, 1); `mass_share` is ε of equation (3).
    """
    predicted = load_state(memory, STATE, lane)
    innovation = combine(-1.0, predicted, measured if has_rates else with_rates(measured, predicted))
    store_vectors(memory, INNOVATION, lane, innovation)
    sine, cosine = sincos(predicted.euler.z)
    x, d = model_state(innovation, -sine, cosine), load_forces(memory, DISTURBANCE, lane)
    for i in range(gain.shape[0]):
        buffer[i, 0] = _corrected(gain, i, 0, x)
    if gain.shape[1] > MODEL_STATE_SIZE:
        limit = _GUST * p.bob_mass * p.gravity
        share = min((d.bob_force.x * d.bob_force.x + d.bob_force.y * d.bob_force.y) / (limit * limit), 1.0)
        for i in range(gain.shape[0]):
            buffer[i, 0] += share * _corrected(gain, i, MODEL_STATE_SIZE, x)
    state = project_direction(combine(1.0, state_of_model(buffer, sine, cosine), predicted))
    store_vectors(memory, STATE, lane, state)
    force, bob_force = turn3(load(buffer, _FORCE, 0), sine, cosine), turn3(load(buffer, _BOB_FORCE, 0), sine, cosine)
    torque = load(buffer, _TORQUE, 0)
    if rigid is not None:  # a vector of the world frame
        torque = turn3(torque, sine, cosine)
    force_z, ratio = _bounded(d.force.z + force.z), memory[MASS_RATIO, lane]
    weight = (p.quadrotor_mass + p.bob_mass) * p.gravity
    memory[MASS_RATIO, lane] = min(max(ratio - mass_share * force_z / weight, _LEAST_MASS), _GREATEST_MASS)
    force_z += (memory[MASS_RATIO, lane] - ratio) * weight
    forces = Forces(
        Vec3(_bounded(d.force.x + force.x), _bounded(d.force.y + force.y), force_z),
        Vec3(_bounded(d.bob_force.x + bob_force.x), _bounded(d.bob_force.y + bob_force.y), d.bob_force.z),
        Vec3(_bounded(d.torque.x + torque.x), _bounded(d.torque.y + torque.y), _bounded(d.torque.z + torque.z)),
    )
    store_vectors(memory, DISTURBANCE, lane, forces)
    store_vectors(memory, REFERENCE, lane, reference)
    if rigid is not None:
        store_attitude(memory, RIGID_PART, lane, state)


@inlined
def _bounded(value: float) -> float:
    return min(max(value, -_MAX_ESTIMATE), _MAX_ESTIMATE)


@inlined
def is_bounded(memory: Any, lane: int, size: int, limit: float) -> bool:
    """Return whether the first `size` numbers are below a limit; false for nan as well."""
    out = True
    for i in range(size):
        out = out and abs(memory[i, lane]) < limit
    return out


@compiled
def _observe(
    last: Any, measurement: Floats, table: Floats, mass_share: float, packed: Any, packed_rigid: Any, out: Floats
) -> None:
    (before, action, started), loop, memory, buffer = last, unpack_loop(packed), out.T, np.empty((BUFFER_SIZE, 1))
    rigid, model = None if packed_rigid is None else unpack_rigid(packed_rigid), loop.plant.pendulum
    for row in range(out.shape[0]):
        measured, _, wanted = law_inputs(measurement, row)
        has_rates = not np.isnan(measured.velocity.x)
        for i in range(out.shape[1]):  # a copy of slices would compile for two seconds
            out[row, i] = 0.0 if started[row] else before[row, i]
        if started[row]:
            begin(memory, row, measured, has_rates, wanted, model, rigid)
        else:
            gain = table[min(int(before[row, AGE]), table.shape[0] - 1)]
            advance(memory, row, load_action(action, row), 0, loop, rigid, buffer)
            correct(memory, row, measured, has_rates, wanted, gain, mass_share, model.vehicle, rigid, buffer)
            is_valid = is_bounded(memory, row, STATE_SIZE, _MAX_ESTIMATE)
            # A delayed sensor repeats its first sample.
            if not (is_valid and out[row, AGE] > loop.plant.sensor_delay):
                out[row, AGE] = out[row, AGE] if is_valid else 0.0
                begin(memory, row, measured, has_rates, wanted, model, rigid)
        if has_rates and measured.direction.z < _LEAST_HEIGHT:  # L_x is that of an upright pendulum
            store_vectors(memory, STATE, row, measured)
            if rigid is not None:
                store_attitude(memory, RIGID_PART, row, measured)


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
    def tables(self) -> tuple[Floats, Floats]:
        """The gains of the first 100 corrections without and with measured rates, shapes (100, 24, k), see `correct`.

        All later corrections use the last one.
        """
        gains, gust = self.gains, self.gains.gust_walk
        noise = self.loop.noise if gains.models_loop else (0.0, 0.0, 0.0)

        def table(has_rates: bool) -> Floats:
            calm = _gain_table(gains, self.simulation, has_rates, noise)
            if gust == 0.0:
                return calm
            windy = _gain_table(replace(gains, bob_force_walk=gust), self.simulation, has_rates, noise)
            return np.concatenate([calm, windy - calm], axis=2)

        return table(False), table(True)

    def observe(
        self,
        measurement: Estimate,
        before: Estimate | None = None,
        action: Floats32 | None = None,
        started: Booleans | None = None,
    ) -> Estimate:
        """Return the estimates after a measurement.

        Args:
            measurement: The measured states and references.
            before: The estimates one period ago; None: the episodes begin with this measurement.
            action: The actions since then, shape (n, 4).
            started: The rows whose episode begins with this measurement, shape (n,); None: none of them.
        """
        rows = len(measurement.array)
        out = np.empty((rows, self.size))
        if before is None or action is None:
            before, action, started = Estimate(out), np.empty((rows, ACTION_SIZE), np.float32), np.ones(rows, np.bool_)
        elif started is None:
            started = np.zeros(rows, np.bool_)
        table = self.tables[not np.isnan(measurement.state[0, VELOCITY])]
        _observe((before.array, action, started), measurement.array, table, *self.numbers, out)
        return Estimate(out)


@lru_cache(maxsize=32)
def _gain_table(
    gains: EstimatorGains, simulation: Simulation, has_rates: bool, known_noise: tuple[float, float, float]
) -> Floats:
    """Return L of equation (2) for the first 100 corrections, shape (100, 24, 16).

    Columns of rates that are not measured are zero.
    """
    model = linearise_actions(simulation) if gains.models_loop else linearise(simulation)
    states = len(model.transition)  # with the thrusts of the rotors, which are not corrected
    size = states + linear_model.MODEL_DISTURBANCE_SIZE
    is_state, is_disturbance = slice(0, states), slice(states, size)
    transition = np.eye(size)
    transition[is_state, is_state], transition[is_state, is_disturbance] = model.transition, model.disturbance
    walk = _model_disturbance(gains.force_walk, gains.bob_force_walk, gains.torque_walk)
    process = np.diag(np.concatenate([np.zeros(states), walk**2 * simulation.period]))
    by_torque = gains.torque_noise * model.disturbance[:, linear_model.MODEL_TORQUE]
    process[is_state, is_state] += by_torque @ by_torque.T / simulation.period
    noise = np.empty(MODEL_STATE_SIZE)
    fields = linear_model.POSITION, linear_model.EULER, linear_model.PENDULUM
    for columns, known in zip(fields, known_noise, strict=True):
        noise[columns] = max(gains.noise, known) ** 2
    is_rate = np.setdiff1d(np.arange(MODEL_STATE_SIZE), _MEASURED_COLUMNS)
    noise[is_rate] = gains.rate_noise**2
    measured = np.arange(MODEL_STATE_SIZE) if has_rates else _MEASURED_COLUMNS
    output = np.eye(size)[measured]
    initial_disturbance = _model_disturbance(_INITIAL_FORCE, _INITIAL_BOB_FORCE, _INITIAL_TORQUE)
    if gains.models_loop:
        initial_disturbance = walk  # after 1 s
    variance = np.concatenate([noise, np.zeros(states - MODEL_STATE_SIZE), initial_disturbance**2])
    if not has_rates:
        variance[is_rate] = _INITIAL_RATE**2
    covariance = np.diag(variance)
    table = np.zeros((_VARYING_STEPS, size, MODEL_STATE_SIZE))
    kept = np.r_[:MODEL_STATE_SIZE, states:size]
    for step in range(_VARYING_STEPS):
        predicted = transition @ covariance @ transition.T + process
        gain = np.linalg.solve(output @ predicted @ output.T + np.diag(noise[measured]), output @ predicted).T
        error_transition = np.eye(size) - gain @ output
        covariance = error_transition @ predicted @ error_transition.T + gain @ np.diag(noise[measured]) @ gain.T
        table[step][:, measured] = gain
    return np.ascontiguousarray(table[:, kept])


def _model_disturbance(force: float, bob_force: float, torque: float) -> Floats:
    """Return one number per component of d in `linear_model`, shape (8,)."""
    out = np.empty(linear_model.MODEL_DISTURBANCE_SIZE)
    for part, value in zip(_MODEL_PARTS, (force, bob_force, torque), strict=True):
        out[part] = value
    return out
