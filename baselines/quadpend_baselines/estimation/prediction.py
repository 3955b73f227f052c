"""Prediction of an estimate over a control period, and to the time when the next action acts.

    (1)  x̂⁻ = f(x̂, ā, d̂, μ̂),    d̂⁻ = d̂,    ā_k = h(a_k, a_{k−1}, …)       f: one control period, h: `loop.act`

f is that of the simulation itself, with nominal parameters, and delays the action by the latency of the simulation, by
the schedule of the environments (`quadpend_gym.envs.loops`). The masses are those of the mass ratio μ̂. The state of a
rigid vehicle includes the thrusts of its rotors.

The reference moves along, as a polynomial of order 6.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.estimate import (
    DISTURBANCE,
    DRAG,
    LOOP,
    MASS_RATIO,
    PLACE,
    POLE,
    REFERENCE,
    RIGID_PART,
    STATE,
    YAW,
    Estimate,
    project_direction,
    rebase,
)
from quadpend_baselines.estimation.loop import Loop, act
from quadpend_baselines.modelling.equivalent import Pendulum, equivalent_model
from quadpend_baselines.modelling.quantities import load_state, store_vectors
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.packing import pack, unpacker
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.physics.attitude import Quaternion, rotation_matrix
from quadpend_gym.physics.drag import AIR_DENSITY, drag_force, rotor_drag_force
from quadpend_gym.physics.euler_kernel import EulerSettings, integrate_euler
from quadpend_gym.physics.plant_kernel import LOOP_SIZE
from quadpend_gym.physics.rigid_kernel import QUATERNION, RIGID, RIGID_LANE_SIZE, RIGID_SIZE, integrate_rigid
from quadpend_gym.physics.rigid_settings import RigidSettings, unpack_rigid
from quadpend_gym.physics.state import ACTION_SIZE, BOB_FORCE, DISTURBANCE_SIZE, FORCE, STATE_SIZE
from quadpend_gym.physics.vectors import Four, Vec3, add, axpy, load, load_four, scale, store, store_four
from quadpend_gym.vehicles.parameters import BOB_MASS, PARAMETERS_SIZE, QUADROTOR_MASS, ROD_LENGTH

# Fields of the buffer in which an estimate is advanced: the lanes of the kernels, parameters, the action before and
# this one, disturbance, velocity of the air, and command.
_PARAMETERS = RIGID_LANE_SIZE
_BEFORE = _PARAMETERS + PARAMETERS_SIZE
_ACTION = _BEFORE + ACTION_SIZE
_FORCES = _ACTION + ACTION_SIZE
_AIR = _FORCES + DISTURBANCE_SIZE
ACTED = _AIR + 3
BUFFER_SIZE = ACTED + ACTION_SIZE


class PlantNumbers(NamedTuple):
    """The vehicle and its known loop inside compiled functions."""

    pendulum: Pendulum
    quadrotor_drag_area: float  # m²
    bob_drag_area: float  # m²
    command_scale: Four  # see `Simulation.command_scale`
    delay: int  # periods from the choice of an action until it acts
    sensor_delay: int  # those among them that delay the measurement
    moves: float  # 1: the anchor of an estimate moves with the reference; 0: it stays


class LoopNumbers(NamedTuple):
    """The vehicle and the parts of a known loop by which an estimate advances in turn, see `Prediction`."""

    parts: Any  # length (s) and substeps, shape (k, 2)
    nominal: Any  # see `Schedule.loops`, shape (10 + s, 1)
    lags: Any  # `Loop.numbers` of each part, shape (k, m, 2)
    plant: PlantNumbers


unpack_plant = unpacker(PlantNumbers)


@inlined
def unpack_loop(packed: Any) -> LoopNumbers:
    """Return the numbers that `Prediction.numbers` has packed."""
    return LoopNumbers(packed[0], packed[1], packed[2], unpack_plant(packed[3]))


@inlined
def move_reference(memory: Any, lane: int, t: float) -> None:
    """Advance the reference by a time t (s)."""
    for axis in range(3):
        place, first = PLACE + axis, REFERENCE + axis
        a, b, c = memory[first, lane], memory[first + 3, lane], memory[first + 6, lane]
        d, e = memory[first + 9, lane], memory[first + 12, lane]
        shift = t * t / 2.0 * (a + t / 3.0 * (b + t / 4.0 * (c + t / 5.0 * (d + t / 6.0 * e))))
        memory[place, lane] += t * memory[place + 3, lane] + shift
        memory[place + 3, lane] += t * (a + t / 2.0 * (b + t / 3.0 * (c + t / 4.0 * (d + t / 5.0 * e))))
        memory[first, lane] = a + t * (b + t / 2.0 * (c + t / 3.0 * (d + t / 4.0 * e)))
        memory[first + 3, lane] = b + t * (c + t / 2.0 * (d + t / 3.0 * e))
        memory[first + 6, lane] = c + t * (d + t / 2.0 * e)
        memory[first + 9, lane] = d + t * e


@inlined
def store_drag(memory: Any, lane: int, known: float, areas: tuple[float, float], rotor_drag: Vec3) -> None:
    """Write the velocity of the reference and the coefficients of the drag there, where it is known (1).

    The drag areas (m²) are those of quadrotor and bob.
    """
    d, half = rotor_drag, 0.5 * known * AIR_DENSITY
    store(memory, DRAG, lane, load(memory, PLACE + 3, lane))
    drag = Four(0.5 * known * (d.x + d.y), known * d.z, half * areas[0], half * areas[1])
    store_four(memory, DRAG + 3, lane, drag)


@inlined
def advance(
    memory: Any, lane: int, action: Four, k: int, loop: LoopNumbers, rigid: RigidSettings | None, buffer: Any
) -> None:
    """Advance an estimate in place by equation (1) over part k of the loop, without a correction.

    Its reference moves along. The buffer has the shape (BUFFER_SIZE, 1).
    """
    plant, lags = loop.plant, loop.lags[k]
    period, substeps, numbers = loop.parts[k, 0], int(loop.parts[k, 1]), loop.nominal
    issued, acting, command = buffer[_BEFORE:_FORCES], buffer[_ACTION:_FORCES], buffer[ACTED:BUFFER_SIZE]
    store_four(acting, 0, 0, action)
    act(acting, plant.delay, lags, memory, LOOP, lane)
    last = LOOP + ACTION_SIZE * (plant.delay + lags.shape[0])
    if numbers[LOOP_SIZE, 0] > 0.0:
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
    buffer[_PARAMETERS + BOB_MASS, 0] = memory[MASS_RATIO, lane] * (p.bob_mass + memory[POLE + 1, lane])
    buffer[_PARAMETERS + ROD_LENGTH, 0] = p.rod_length + memory[POLE, lane]
    buffer[_PARAMETERS + PARAMETERS_SIZE - 2, 0] = plant.quadrotor_drag_area
    buffer[_PARAMETERS + PARAMETERS_SIZE - 1, 0] = plant.bob_drag_area
    lanes, parameters, forces = buffer[:_PARAMETERS], buffer[_PARAMETERS:_BEFORE], buffer[_FORCES:_AIR]
    air = buffer[_AIR:ACTED]
    if rigid is None:
        own = EulerSettings(plant.command_scale, False)
        integrate_euler(lanes, issued, numbers, forces, air, air, parameters, own, 1, period, substeps, command)
    else:
        for i in range(RIGID_SIZE):
            buffer[RIGID + i, 0] = memory[RIGID_PART + i, lane]
        store(air, 0, 0, Vec3(0.0, 0.0, 0.0))
        integrate_rigid(lanes, issued, numbers, forces, air, air, parameters, rigid, 1, period, substeps, command)
        for i in range(RIGID_SIZE):
            memory[RIGID_PART + i, lane] = buffer[RIGID + i, 0]
        areas = plant.quadrotor_drag_area, plant.bob_drag_area
        store_drag(memory, lane, 1.0 - plant.moves, areas, rigid.rotor_drag)
    for i in range(STATE_SIZE):
        memory[i, lane] = buffer[i, 0]
    move_reference(memory, lane, period)
    rebase(memory, lane, plant.moves)


@inlined
def arrive(memory: Any, lane: int, loop: LoopNumbers) -> None:
    """Finish an estimate in place that was advanced by all parts but the first, to when the next action acts."""
    time, yaw = 0.0, load(memory, YAW, lane)
    for k in range(1, loop.parts.shape[0]):
        time += loop.parts[k, 0]
    store_vectors(memory, STATE, lane, project_direction(load_state(memory, STATE, lane)))
    store(memory, YAW, lane, Vec3(yaw.x + time * (yaw.y + time / 2.0 * yaw.z), yaw.y + time * yaw.z, yaw.z))


@inlined
def add_reference_drag(memory: Any, lane: int, loop: LoopNumbers, rigid: RigidSettings | None) -> None:
    """Add to the forces of an estimate the drag that the velocity of the reference adds to that of the relative one.

    Networks know no velocity but the relative one, and take the drag of the reference for wind. Laws know it, see
    `modelling.trajectory_drag`.
    """
    plant, state, d1 = loop.plant, load_state(memory, STATE, lane), load(memory, PLACE + 3, lane)
    v = scale(-1.0, state.velocity)
    bob = axpy(-(plant.pendulum.vehicle.rod_length + memory[POLE, lane]), state.direction_rate, v)
    on_vehicle = _more_drag(plant.quadrotor_drag_area, v, d1)
    if rigid is not None:
        q = load_four(memory, RIGID_PART + QUATERNION, lane)
        rotation = rotation_matrix(Quaternion(q.a, q.b, q.c, q.d))
        on_vehicle = axpy(-1.0, rotor_drag_force(rigid.rotor_drag, rotation, d1), on_vehicle)
    first, second = DISTURBANCE + FORCE, DISTURBANCE + BOB_FORCE
    store(memory, first, lane, add(load(memory, first, lane), on_vehicle))
    store(memory, second, lane, add(load(memory, second, lane), _more_drag(plant.bob_drag_area, bob, d1)))
    for i in range(LOOP - DRAG):  # it is in the forces
        memory[DRAG + i, lane] = 0.0


@inlined
def _more_drag(area: float, air: Vec3, velocity: Vec3) -> Vec3:
    """Return the drag in relative air less that in air that moves faster by a velocity, N."""
    return axpy(-1.0, drag_force(area, add(air, velocity)), drag_force(area, air))


@inlined
def load_action(action: Any, row: int) -> Four:
    """Return an action of n rows, shape (n, 4), in double precision."""
    a = action[row]
    return Four(float(a[0]), float(a[1]), float(a[2]), float(a[3]))


@compiled
def _advance(
    estimate: Floats, action: Floats32, first: int, end: int, packed: Any, packed_rigid: Floats | None, acted: Floats
) -> None:
    """Advance estimates over parts of the loop; `acted` gets thrust (N) and torques (N·m) of the last one."""
    loop, buffer = unpack_loop(packed), np.empty((BUFFER_SIZE, 1))
    rigid = None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(estimate.shape[0]):
        for k in range(first, end):
            advance(estimate.T, row, load_action(action, row), k, loop, rigid, buffer)
        store_four(acted.T, 0, row, load_four(buffer, ACTED, 0))


@compiled
def _arrive(estimate: Floats, packed: Any) -> None:
    loop = unpack_loop(packed)
    for row in range(estimate.shape[0]):
        arrive(estimate.T, row, loop)


@compiled
def _add_reference_drag(estimate: Floats, packed: Any, packed_rigid: Floats | None) -> None:
    loop, rigid = unpack_loop(packed), None if packed_rigid is None else unpack_rigid(packed_rigid)
    for row in range(estimate.shape[0]):
        add_reference_drag(estimate.T, row, loop, rigid)


@dataclass(frozen=True)
class Prediction:
    """Equation (1) for n rows."""

    simulation: Simulation  # nominal plant and control period
    known_loop: Loop  # the known part of the loop, without the latency of the simulation

    @cached_property
    def loop(self) -> Loop:
        """The known part of the loop, with the whole periods of the latency."""
        return replace(self.known_loop, delay=self.known_loop.delay + self._latency[0])

    @cached_property
    def _latency(self) -> tuple[int, int]:
        """The latency in whole control periods and the remaining substeps."""
        return divmod(self.simulation.delayed_substeps, self.simulation.substeps)

    @cached_property
    def loop_size(self) -> int:
        """Length of the memory of the known loop, with the last action if it is needed."""
        return ACTION_SIZE * (self.loop.steps + len(self.loop.lags) + (self._latency[1] > 0))

    @cached_property
    def parts(self) -> Floats:
        """The control period, and the periods and parts of one until the next action acts: s and substeps, (k, 2)."""
        substeps, switch = self.simulation.substeps, self._latency[1]
        substep = self.simulation.period / substeps
        numbers = [substeps] * (1 + self.loop.steps)
        rest = switch + round(sum(self.loop.lags) / substep)
        while rest > 0:
            numbers.append(min(rest, substeps))
            rest -= numbers[-1]
        return np.array([[n * substep if n < substeps else self.simulation.period, n] for n in numbers])

    @cached_property
    def lags(self) -> Floats:
        """The lags in each of the parts, shape (k, m, 2)."""
        return np.array([self.loop.numbers(period) for period in self.parts[:, 0]])

    @cached_property
    def numbers(self) -> tuple[Any, Floats | None]:
        """What compiled functions need: packed `LoopNumbers`, and packed settings of a rigid vehicle."""
        model, p, scale = equivalent_model(self.simulation), self.simulation.parameters, self.simulation.command_scale
        areas, loop = (p.quadrotor_drag_area, p.bob_drag_area), self.loop
        plant = PlantNumbers(
            model.numbers, *areas, Four(*scale.tolist()), loop.steps, loop.sensor_delay, 1.0 - loop.in_world
        )
        rest = self._latency[1] * self.simulation.period / self.simulation.substeps
        schedule = Schedule(None, replace(self.simulation, latency=rest), 1)
        return (self.parts, schedule.loops, self.lags, pack(plant)), model.packed_rigid

    def carry_forward(self, estimate: Estimate, action: Floats32) -> Estimate:
        """Return the estimate at the time when the next action acts.

        The latest action that the controller has chosen, shape (n, 4), is taken to continue while a lag is predicted
        through.
        """
        if len(self.parts) == 1:
            return estimate
        then = Estimate(estimate.array.copy())
        self._advance(then.array, action, 1, len(self.parts))
        _arrive(then.array, self.numbers[0])
        return then

    def with_reference_drag(self, estimate: Estimate) -> Estimate:
        """Return an estimate with the forces that networks get, see `add_reference_drag`."""
        if not self.loop.in_world:  # the velocity of the reference is unknown
            return estimate
        then = Estimate(estimate.array.copy())
        _add_reference_drag(then.array, *self.numbers)
        return then

    def advance(self, estimate: Floats, action: Floats32) -> Floats:
        """Advance estimates, shape (n, k), in place by a control period; return thrust (N) and torques (N·m), (n, 4).

        These are means over the period.
        """
        return self._advance(estimate, action, 0, 1)

    def _advance(self, estimate: Floats, action: Floats32, first: int, end: int) -> Floats:
        acted = np.empty((len(estimate), ACTION_SIZE))
        _advance(estimate, action, first, end, *self.numbers, acted)
        return acted
