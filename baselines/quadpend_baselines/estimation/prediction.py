"""Prediction of the state: the nonlinear simulation, driven by the action that passes through the known loop.

    (1)  x_{k+1} = f(x_k, ā_k, d̂, μ̂),   ā_k = h(a_k, a_{k−1}, …)          f: one control period, h: `loop.act`

Positions and velocities are relative to the reference, which accelerates. The prediction therefore subtracts the motion
of the reference over a period, a polynomial of order 6. The state of a rigid vehicle includes the thrusts of its
rotors, which are predicted without correction; f delays the action by the latency of the simulation.

An estimate is a flat vector with this layout (`Estimate` names its parts):

| fields | name          | content                                                                                    |
|--------|---------------|--------------------------------------------------------------------------------------------|
| 0–17   | `state`       | x̂ as in `quadpend_gym.physics.state`; position and velocity are relative to the reference  |
| 18–26  | `disturbance` | d̂, laid out as `Disturbance`, N and N·m                                                    |
| 27–41  | `reference`   | F_d⁽ⁱ⁾ for i = 2 … 6 of the latest measurement                                             |
| 42     | `mass_ratio`  | μ̂, effective ratio of weight to thrust, which scales the masses of quadrotor and bob      |
| 43     | `age`         | number of corrections since the episode began                                              |
| 44–61  | `innovation`  | measured minus predicted state before the latest correction; 0 for rates not measured      |
| 62–72  | `rigid`       | quaternion, body rate and rotor thrusts of a rigid vehicle, see `physics.rigid_kernel`     |
| 73–    |               | memory of the known loop, see `loop.act`; with a latency that is not a whole number of     |
|        |               | periods then the action before                                                             |
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.loop import Loop, act, compensate
from quadpend_baselines.modelling.equivalent import Pendulum, equivalent_model
from quadpend_baselines.modelling.quantities import (
    Derivatives,
    Forces,
    VehicleState,
    load_derivatives,
    load_forces,
    load_state,
    store_state,
)
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.physics.attitude import body_rate, quaternion_from_euler
from quadpend_gym.physics.euler_kernel import integrate, store_command
from quadpend_gym.physics.rigid_kernel import (
    BODY_RATE,
    QUATERNION,
    RIGID,
    RIGID_LANE_SIZE,
    RIGID_SIZE,
    integrate_rigid,
)
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, POSITION, STATE_SIZE, VELOCITY
from quadpend_gym.physics.vectors import Four, Vec3, load, store, store_four
from quadpend_gym.vehicles.parameters import BOB_MASS, PARAMETERS_SIZE, QUADROTOR_MASS

_MAX_HORIZONTAL = 0.95  # bound of |r_xy| of an estimate: 72° from upright; the default limit of an episode is 60°
ORDERS = 5  # derivatives of the reference, of order 2 … 6
STATE, DISTURBANCE, REFERENCE, MASS_RATIO, AGE, INNOVATION, RIGID_PART, LOOP = 0, 18, 27, 42, 43, 44, 62, 73
# Fields of the buffer in which an estimate is advanced: the lanes of the kernels, parameters, action and the one
# before, disturbance and velocity of the air.
_PARAMETERS = RIGID_LANE_SIZE
_ACTION = _PARAMETERS + PARAMETERS_SIZE
_BEFORE = _ACTION + ACTION_SIZE
_FORCES = _BEFORE + ACTION_SIZE
_AIR = _FORCES + DISTURBANCE_SIZE
BUFFER_SIZE = _AIR + 3


class Measurement(NamedTuple):
    """Observations of n rows, converted for the estimator."""

    # Layout of `quadpend_gym.physics.state`, shape (n, 18); position and velocity are relative to the reference, and
    # rates that are not measured are nan
    state: Floats
    reference: Floats  # F_d⁽ⁱ⁾ for i = 2 … 6, shape (n, 5, 3)
    yaw_reference: Floats  # ψ_d, ψ̇_d, ψ̈_d, in rad, rad/s and rad/s², shape (n, 3)


class Estimate(NamedTuple):
    """Named views of n estimates, see the table above; writing into a view writes into the array.

    Attributes:
        array: Shape (n, k).
    """

    array: Floats

    @classmethod
    def of(cls, state: Floats, disturbance: Floats, reference: Floats) -> "Estimate":
        """Return estimates with given states, (n, 18), disturbances, (n, 9), and references, (n, 5, 3)."""
        out = cls(np.zeros((len(state), LOOP)))
        out.state[:], out.disturbance[:], out.mass_ratio[:] = state, disturbance, 1.0
        out.array[:, REFERENCE:MASS_RATIO] = reference.reshape(len(state), -1)
        return out

    @property
    def state(self) -> Floats:
        """Return x̂, shape (n, 18)."""
        return self.array[:, STATE:DISTURBANCE]

    @property
    def disturbance(self) -> Floats:
        """Return d̂, N and N·m, shape (n, 9)."""
        return self.array[:, DISTURBANCE:REFERENCE]

    @property
    def reference(self) -> Floats:
        """Return the reference, shape (n, 5, 3)."""
        return self.array[:, REFERENCE:MASS_RATIO].reshape(-1, ORDERS, 3)

    @property
    def mass_ratio(self) -> Floats:
        """Return μ̂, shape (n,)."""
        return self.array[:, MASS_RATIO]

    @property
    def innovation(self) -> Floats:
        """Return the innovation, shape (n, 18)."""
        return self.array[:, INNOVATION:RIGID_PART]

    @property
    def rigid(self) -> Floats:
        """Return quaternion, body rate and rotor thrusts of a rigid vehicle, shape (n, 11)."""
        return self.array[:, RIGID_PART:LOOP]


class PlantNumbers(NamedTuple):
    """The vehicle and its known loop inside compiled functions."""

    pendulum: Pendulum
    quadrotor_drag_area: float  # m²
    bob_drag_area: float  # m²
    command_scale: Four  # see `Simulation.command_scale`
    delay: int  # periods from the choice of an action until it acts
    sensor_delay: int  # those among them that delay the measurement


class Part(NamedTuple):
    """A period, or a part of one, by which an estimate advances."""

    period: float  # s
    substeps: float
    switch: float  # substeps at its beginning in which the action before acts


unpack_plant = unpacker(PlantNumbers)


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
    memory: Any,
    lane: int,
    action: Four,
    part: Part,
    actuators: Any,
    plant: PlantNumbers,
    rigid: RigidSettings | None,
    buffer: Any,
) -> None:
    """Advance an estimate in place by equation (1), without a correction; its reference moves along.

    Args:
        memory: Estimates, shape (k, n).
        lane: Column.
        action: The action that the controller has chosen.
        part: Period.
        actuators: `Loop.numbers` for this period.
        plant: The vehicle and its loop.
        rigid: Settings of a rigid vehicle; None: the paper's vehicle.
        buffer: Buffer, shape (BUFFER_SIZE, 1).
    """
    acting, before = buffer[_ACTION:_BEFORE], buffer[_BEFORE:_FORCES]
    store_four(acting, 0, 0, action)
    act(acting, plant.delay, actuators, memory, LOOP, lane)
    last = LOOP + ACTION_SIZE * (plant.delay + actuators.shape[0])
    if part.switch > 0.0:
        for i in range(ACTION_SIZE):
            before[i, 0], memory[last + i, lane] = memory[last + i, lane], acting[i, 0]
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
    lanes, parameters, forces = buffer[:_PARAMETERS], buffer[_PARAMETERS:_ACTION], buffer[_FORCES:_AIR]
    if rigid is None:
        store_command(acting, plant.command_scale, 0, acting)
        integrate(lanes, acting, forces, parameters, 1, part.period, int(part.substeps))
    else:
        for i in range(RIGID_SIZE):
            buffer[RIGID + i, 0] = memory[RIGID_PART + i, lane]
        air = buffer[_AIR:BUFFER_SIZE]
        store(air, 0, 0, Vec3(0.0, 0.0, 0.0))
        substeps, switch = int(part.substeps), int(part.switch)
        integrate_rigid(lanes, before, acting, forces, air, parameters, rigid, 1, part.period, substeps, switch)
        for i in range(RIGID_SIZE):
            memory[RIGID_PART + i, lane] = buffer[RIGID + i, 0]
    for i in range(STATE_SIZE):
        memory[i, lane] = buffer[i, 0]
    _move_reference(memory, lane, part.period)
    memory[AGE, lane] += 1.0


@inlined
def carry_forward(
    memory: Any,
    lane: int,
    action: Four,
    yaw: Vec3,
    parts: Any,
    actuators: Any,
    plant: PlantNumbers,
    rigid: RigidSettings | None,
    buffer: Any,
) -> Vec3:
    """Advance an estimate in place to the time when the next action acts, and return the yaw reference then.

    The latest action that the controller has chosen is taken to continue while a lag of the actuators is predicted
    through. `parts` has a row for each period or part of one after the first, see `Prediction.parts`.
    """
    time = 0.0
    for i in range(1, parts.shape[0]):
        part = Part(parts[i, 0], parts[i, 1], parts[i, 2])
        advance(memory, lane, action, part, actuators[i], plant, rigid, buffer)
        time += part.period
    store_state(memory, STATE, lane, project_direction(load_state(memory, STATE, lane)))
    return Vec3(yaw.x + time * (yaw.y + time / 2.0 * yaw.z), yaw.y + time * yaw.z, yaw.z)


@inlined
def law_inputs(estimate: Any, measurement: Any, row: int) -> tuple[VehicleState, Forces, Derivatives]:
    """Return estimated state and disturbance, and the reference, of one row of the arrays of n rows."""
    state, forces = load_state(estimate.T, STATE, row), load_forces(estimate.T, DISTURBANCE, row)
    return state, forces, load_derivatives(measurement.reference[row], load(measurement.yaw_reference.T, 0, row))


@inlined
def load_action(action: Any, row: int) -> Four:
    """Return an action of n rows, shape (n, 4), in double precision."""
    a = action[row]
    return Four(float(a[0]), float(a[1]), float(a[2]), float(a[3]))


@compiled
def _carry(
    memory: Floats, action: Floats32, yaw: Floats, loop: Any, packed_rigid: Floats | None, out: Floats, out_yaw: Floats
) -> None:
    (parts, actuators, packed_plant), buffer = loop, np.empty((BUFFER_SIZE, 1))
    plant, rigid = unpack_plant(packed_plant), None if packed_rigid is None else unpack_rigid(packed_rigid)
    out[:] = memory
    for row in range(out.shape[0]):
        heading, chosen = load(yaw.T, 0, row), load_action(action, row)
        then = carry_forward(out.T, row, chosen, heading, parts, actuators, plant, rigid, buffer)
        store(out_yaw.T, 0, row, then)


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
        """The control period, and the periods and parts of one until the next action acts: `Part`s, shape (k, 3)."""
        substeps, switch = self.simulation.substeps, self._latency[1]
        substep = self.simulation.period / substeps
        numbers = [substeps] * (1 + self.loop.steps)
        rest = switch + round(self.loop.lag / substep)
        while rest > 0:
            numbers.append(min(rest, substeps))
            rest -= numbers[-1]
        return np.array([[n * substep if n < substeps else self.simulation.period, n, switch] for n in numbers])

    @cached_property
    def actuators(self) -> Floats:
        """The actuators in each of the parts, shape (k, m, 4)."""
        return np.array([self.loop.numbers(period) for period in self.parts[:, 0]])

    @cached_property
    def numbers(self) -> tuple[Any, Floats | None]:
        """What compiled functions need: parts, actuators, packed `PlantNumbers`, packed settings of a rigid vehicle."""
        model, p, scale = equivalent_model(self.simulation), self.simulation.parameters, self.simulation.command_scale
        areas, loop = (p.quadrotor_drag_area, p.bob_drag_area), self.loop
        plant = PlantNumbers(model.numbers, *areas, Four(*scale.tolist()), loop.steps, loop.sensor_delay)
        return (self.parts, self.actuators, pack(plant)), model.packed_rigid

    def compensate(self, wanted: Floats32, estimate: Floats) -> Floats32:
        """Return the actions that compensate the lags of the loop, shape (n, 4), see `loop.compensate`.

        The estimate, shape (n, k), is that of the time when the action acts.
        """
        if not self.actuators[0, :, 3].any():
            return wanted
        out = wanted.astype(np.float64)
        _compensate(out, self.loop.steps, self.actuators[0], estimate)
        return out.astype(np.float32)

    def carry_forward(
        self, estimate: Estimate, action: Floats32, measurement: Measurement
    ) -> tuple[Estimate, Measurement]:
        """Return estimate and measurement at the time when the next action acts.

        Args:
            estimate: The latest estimate.
            action: The latest action that the controller has chosen, shape (n, 4).
            measurement: The latest measurement. Only its reference is carried forward.
        """
        if len(self.parts) == 1:
            return estimate, measurement
        then, yaw = Estimate(np.empty_like(estimate.array)), np.empty_like(measurement.yaw_reference)
        _carry(estimate.array, action, measurement.yaw_reference, *self.numbers, then.array, yaw)
        return then, Measurement(measurement.state, then.reference, yaw)
