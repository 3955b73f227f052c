"""The compiled control step of n sub-environments: action, wind and drag, integration, measurement, observation.

The step reads and writes plain arrays: the memory and the settings (`kernel_layout`), the actions under way (`loops`),
the outcome (`outcome`), the observation (`quadpend_gym.tasks.observation`) and the wind (`quadpend_gym.wind`). For each
sub-environment, the stage `ADVANCE`

1. finds the action that acts in each substep, and converts it to thrust and torques (`Simulation.command_scale`),
2. adds the wind's forces and torque, and drag if the wind has a velocity (`quadpend_gym.physics.drag`),
3. integrates the equations of motion over one control period (`quadpend_gym.physics.euler_kernel`,
   `quadpend_gym.physics.rigid_kernel`),

and the stage `MEASURE`

4. evaluates the reference and measures tracking errors, reward terms and termination,
5. writes outcome and observation.

Sub-environments are processed in blocks of 64, copied into (field, lane) buffers so that the compiler can vectorise
each loop over lanes. A single sub-environment runs the same code, so its numbers are the same to the last bit.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.elementary import arcsin, select
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.envs import kernel_layout as layout
from quadpend_gym.envs import outcome as rows
from quadpend_gym.envs.inputs import NO_ERROR, find_error
from quadpend_gym.physics.euler_kernel import EULER_KERNEL
from quadpend_gym.physics.plant_kernel import (
    BLOCK,
    DIVERGENCE_LIMIT,
    LANE_STATE_SIZE,
    THRUST_AXIS,
    PlantKernel,
    gather,
    scatter,
)
from quadpend_gym.physics.rigid_kernel import HELD_KERNEL, RIGID_KERNEL
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, DIRECTION_RATE, POSITION, STATE_SIZE
from quadpend_gym.physics.vectors import Vec3, load, norm, store, store_four
from quadpend_gym.tasks.observation import (
    ALL,
    FULL,
    LAB_STATE_COLUMNS,
    STATE_COLUMNS,
    Target,
    load_target,
    observe_measured,
    observe_reference,
    observe_state,
    observe_target,
    store_target,
    tracking_errors,
)
from quadpend_gym.tasks.references import REFERENCE_SIZE, ReferencePoint, load_point
from quadpend_gym.tasks.rewards import reward, reward_terms
from quadpend_gym.tasks.trajectories import reference_at
from quadpend_gym.vehicles.parameters import ROD_LENGTH
from quadpend_gym.wind import HAND, SAMPLE_SIZE, WIND_SIZE

# Parts of one buffer of shape (rows, lanes): the outcome, the sensed values followed by the thrust axis and what the
# vehicle has besides, the action, the reference, the time, and whether the state has diverged.
_SENSED = slice(rows.OUTCOME_SIZE, rows.OUTCOME_SIZE + layout.SENSED_AGE)
_STATE, _ACTION, _REFERENCE, _TIME, _LOST, _END = accumulate(
    (rows.OUTCOME_SIZE + layout.SENSED_STATE.start, RIGID_KERNEL.lane_size, ACTION_SIZE, REFERENCE_SIZE, 1, 1)
)
_OBSERVED, _USUAL = ALL.size, FULL.size  # rows of the buffer of the observation; the others are those of a lab
_WIND = slice(rows.DISTURBANCE.start, rows.AIR_VELOCITY.stop)
_TRACKING_ERROR = rows.TRACKING_ERROR.start  # first row, for `store`

# Stages of a control step, which are added: to advance the vehicles, and to measure and observe them.
ADVANCE, MEASURE = 1, 2
STEP = ADVANCE + MEASURE


@inlined
def _copy(lanes_in: Any, lanes: int, out: Any) -> None:
    if lanes == 1:  # one loop instead of many short ones
        for field in range(out.shape[0]):
            out[field, 0] = lanes_in[field, 0]
        return
    for field in range(out.shape[0]):
        for lane in range(lanes):
            out[field, lane] = lanes_in[field, lane]


@inlined
def has_diverged(state: Any, lane: int) -> float:
    """Return 1 if a state is not finite or too large, else 0."""
    size = 0.0
    for field in range(STATE_SIZE):
        size = size + abs(state[field, lane])
    return select(size < DIVERGENCE_LIMIT, 0.0, 1.0)


@inlined
def cause_of_fall(state: Any, lane: int, error: Vec3, rod_length: float, limits: layout.KernelLimits) -> float:
    """Return the limit of the task that the state exceeds, a place in `outcome.CAUSES`, or 0."""
    height, vertical = state[POSITION + 2, lane], state[DIRECTION + 2, lane]
    found = select(min(height, height + limits.reach * rod_length * vertical) <= limits.ground, rows.GROUND, 0.0)
    found = select(norm(error) > limits.tracking_error, rows.DISTANCE, found)
    found = select(state[THRUST_AXIS + 2, lane] < limits.cos_body_angle, rows.BODY, found)
    return select(limits.side * vertical < limits.cos_pendulum_angle, rows.POLE, found)


@inlined
def _measure_at(
    point: ReferencePoint,
    state: Any,
    action: Any,
    rod_length: float,
    lane: int,
    task: layout.KernelSettings,
    sensed: Any,
    observation: Any,
    out: Any,
) -> None:
    """Write the target, the reference's part of the observation, and reward, termination, tracking error and tilt."""
    observe_reference(point, lane, observation)
    target = Target(point.d0, point.d1, point.yaw)
    store_target(target, sensed, lane)
    sensed[layout.SENSED_ROD_LENGTH, lane] = rod_length
    tracking = tracking_errors(state, lane, rod_length, target)
    r, limits, weights = load(state, DIRECTION, lane), task.limits, task.weights
    cosine = limits.side * r.z
    terms = reward_terms(tracking.error, cosine, tracking.yaw_error, action, lane, weights.tip)
    store_four(out, rows.TRACKING_TERM, lane, terms)
    store(out, _TRACKING_ERROR, lane, tracking.error)
    out[rows.TILT, lane] = 2.0 * arcsin(min(0.5 * norm(Vec3(r.x, r.y, r.z - limits.side)), 1.0))
    out[rows.REWARD, lane] = reward(terms, cosine, load(state, DIRECTION_RATE, lane), weights)
    out[rows.TERMINATED, lane] = cause_of_fall(state, lane, tracking.error, rod_length, limits)


@inlined
def _run(
    plant: PlantKernel,
    stages: int,
    memory: Any,
    clock: Any,
    columns: Any,
    action: Any,
    loops: Any,
    points: Any,
    task: layout.KernelSettings,
    vehicle: Any,
    observation: Any,
    outcome: Any,
    begin: int,
    end: int,
) -> int:
    """Do stages of a control step, as `run_euler` describes; `vehicle` are the settings of `plant.integrate`."""
    wind, sensed = columns[:WIND_SIZE], columns[SAMPLE_SIZE:]
    begin = max(begin, 0)  # tells the compiler that indices of sub-environments are not negative
    error = find_error(action[begin:end], wind[:, begin:end])
    if error != NO_ERROR:
        return error + begin if error > NO_ERROR else error - begin
    state, parameters = memory[:, layout.MEMORY_STATE], memory[:, layout.MEMORY_PARAMETERS]
    reference, period, substeps = memory[:, layout.MEMORY_REFERENCE], task.period, task.substeps
    issued_from = layout.MEMORY_SIZE + plant.memory_size
    plant_memory, under_way = memory[:, layout.MEMORY_SIZE : issued_from], memory[:, issued_from:]
    buffer, loop_size = np.empty((_END, BLOCK)), loops.shape[0]
    given = np.empty((loop_size + under_way.shape[1] + ACTION_SIZE, BLOCK))
    disturbance_lanes, velocity_lanes = buffer[rows.DISTURBANCE], buffer[rows.AIR_VELOCITY]
    physics_lanes, command_lanes = buffer[rows.PARAMETERS], buffer[rows.COMMAND]
    sensed_lanes, state_lanes, action_lanes = buffer[_SENSED], buffer[_STATE:_ACTION], buffer[_ACTION:_REFERENCE]
    reference_lanes, time, lost = buffer[_REFERENCE:_TIME], buffer[_TIME], buffer[_LOST]
    plant_lanes, loop_lanes, issued = state_lanes[LANE_STATE_SIZE:], given[:loop_size], given[loop_size:]
    observation_lanes = np.empty((_OBSERVED, BLOCK), np.float32)
    for field in range(loops.shape[0]):  # of the only loop, if there is one for all
        for lane in range(min(BLOCK, end - begin)):
            loop_lanes[field, lane] = loops[field, 0]
    for first in range(begin, end, BLOCK):
        lanes = min(BLOCK, end - first)
        gather(state, first, lanes, state_lanes)
        gather(plant_memory, first, lanes, plant_lanes)
        gather(action, first, lanes, action_lanes)
        gather(parameters, first, lanes, physics_lanes)
        _copy(wind[:, first:], lanes, buffer[_WIND])
        if loops.shape[1] > 1:
            _copy(loops[:, first:], lanes, loop_lanes)
        if stages & ADVANCE:
            gather(under_way, first, lanes, issued)
            _copy(action_lanes, lanes, issued[under_way.shape[1] :])
            scatter(issued[ACTION_SIZE:], first, lanes, under_way)
            plant.integrate(
                state_lanes,
                issued,
                loop_lanes,
                disturbance_lanes,
                velocity_lanes,
                columns[HAND, first:],
                physics_lanes,
                vehicle,
                lanes,
                period,
                substeps,
                command_lanes,
            )
            for lane in range(lanes):
                clock[first + lane] += 1
            for lane in range(lanes):
                lost[lane] = has_diverged(state_lanes, lane)
            for lane in range(lanes):
                if lost[lane] > 0.0:
                    memory[first + lane, layout.MEMORY_DIVERGED] = 1.0
                    for field in range(STATE_SIZE):
                        state_lanes[field, lane] = state[first + lane, field]
                    for field in range(plant.memory_size):
                        plant_lanes[field, lane] = plant_memory[first + lane, field]
                    plant.store_axis(state_lanes, lane)
            scatter(state_lanes, first, lanes, state)
            scatter(plant_lanes, first, lanes, plant_memory)
        else:
            for lane in range(lanes):
                plant.store_axis(state_lanes, lane)
                plant.store_command(action_lanes, vehicle, loop_lanes, lane, state_lanes, command_lanes)
        if stages & MEASURE:
            gather(reference, first, lanes, reference_lanes)
            for lane in range(lanes):
                time[lane] = period * clock[first + lane]
            for lane in range(lanes):
                point, length = reference_at(reference_lanes, lane, time[lane]), physics_lanes[ROD_LENGTH, lane]
                out = sensed_lanes, observation_lanes, buffer
                _measure_at(point, state_lanes, action_lanes, length, lane, task, *out)
            if points.shape[1] > 0:
                for lane in range(lanes):
                    if memory[first + lane, layout.MEMORY_TRAJECTORY] >= 0.0:
                        point, length = load_point(points, first + lane), physics_lanes[ROD_LENGTH, lane]
                        out = sensed_lanes, observation_lanes, buffer
                        _measure_at(point, state_lanes, action_lanes, length, lane, task, *out)
            for lane in range(lanes):
                if memory[first + lane, layout.MEMORY_DIVERGED] > 0.0:
                    buffer[rows.TERMINATED, lane] = rows.DIVERGED
                    memory[first + lane, layout.MEMORY_DIVERGED] = 0.0
            _copy(buffer, lanes, outcome[:, first:])
            if observation.shape[1] > _USUAL:
                for lane in range(lanes):
                    pole = memory[first + lane, layout.MEMORY_POLE]
                    observe_target(load_target(sensed_lanes, lane), pole[0], pole[1], lane, observation_lanes)
                    observe_measured(state_lanes, lane, 0.0, observation_lanes, lane)
            if task.has_sensors:
                _copy(sensed_lanes, lanes, sensed[: layout.SENSED_AGE, first:])
            else:
                for lane in range(lanes):
                    target, rod_length = load_target(sensed_lanes, lane), physics_lanes[ROD_LENGTH, lane]
                    tracking = tracking_errors(state_lanes, lane, rod_length, target)
                    observe_state(state_lanes, lane, tracking, observation_lanes, lane)
            scatter(observation_lanes, first, lanes, observation)
    return NO_ERROR


@compiled
def run_euler(
    stages: int,
    memory: Floats,
    clock: Integers,
    columns: Floats,
    action: Floats32,
    loops: Floats,
    points: Floats,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    begin: int,
    end: int,
) -> int:
    """Do stages of a control step of the sub-environments begin ≤ i < end of n.

    `ADVANCE` moves the vehicles by one control period. If the state of a sub-environment diverges, it is reset to its
    value before the step, and the episode terminates. `MEASURE` computes outcome and observation of the present state.

    Args:
        stages: `ADVANCE`, `MEASURE`, or `STEP` for both.
        memory: State, parameters, reference, what the vehicle has besides, and actions under way of each
            sub-environment, shape (n, k), see `kernel_layout`; changed in place.
        clock: Control steps since each episode began, shape (n,), changed in place.
        columns: Wind over the control period, laid out as in `quadpend_gym.wind`, shape (16, n). With sensors 27
            further rows, an output but for the age of the samples in the last one: `observe_sensed` then writes the
            state's part of the observation, once the sensors have changed the state in these rows.
        action: Shape (n, 4), each component in [−1, 1]; the reward counts it, even where it acts later.
        loops: The loop of each sub-environment, shape (10 + s, n), or of all, shape (10 + s, 1), see `plant_kernel`.
        points: `TrajectoryTable.points` at the time of `MEASURE`.
        settings: Those of `kernel_layout.pack_settings`.
        observation: Output, shape (n, m), laid out as `quadpend_gym.tasks.observation.ALL`, or as `FULL`.
        outcome: Output, shape (k, at least n): the first k rows of `outcome`.
        begin: A multiple of 64.
        end: A multiple of 64, or n.

    Returns:
        The error code of `inputs`; with an error, no array is changed.
    """
    task, vehicle = layout.unpack_euler(settings)
    inputs = memory, clock, columns, action, loops, points
    return int(_run(EULER_KERNEL, stages, *inputs, task, vehicle, observation, outcome, begin, end))


@compiled
def run_rigid(
    stages: int,
    memory: Floats,
    clock: Integers,
    columns: Floats,
    action: Floats32,
    loops: Floats,
    points: Floats,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    begin: int,
    end: int,
) -> int:
    """As `run_euler`, for rigid vehicles."""
    task, vehicle = layout.unpack_rigid(settings)
    inputs = memory, clock, columns, action, loops, points
    return int(_run(RIGID_KERNEL, stages, *inputs, task, vehicle, observation, outcome, begin, end))


@compiled
def run_held(
    stages: int,
    memory: Floats,
    clock: Integers,
    columns: Floats,
    action: Floats32,
    loops: Floats,
    points: Floats,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    begin: int,
    end: int,
) -> int:
    """As `run_rigid`, for vehicles whose poles a hand can hold."""
    task, vehicle = layout.unpack_rigid(settings)
    inputs = memory, clock, columns, action, loops, points
    return int(_run(HELD_KERNEL, stages, *inputs, task, vehicle, observation, outcome, begin, end))


KERNELS: dict[PlantKernel, Any] = {EULER_KERNEL: run_euler, RIGID_KERNEL: run_rigid, HELD_KERNEL: run_held}


@compiled
def observe_sensed(columns: Floats, observation: Floats32) -> None:
    """Write the part of the observation, shape (n, m), that depends on the state, from the sensed state.

    `columns` is the array that a step has written and the sensors have changed, shape (43, n).
    """
    sensed = columns[SAMPLE_SIZE:]
    state, lanes = sensed[layout.SENSED_STATE], np.empty((_OBSERVED, BLOCK), np.float32)
    for first in range(0, sensed.shape[1], BLOCK):
        size = min(BLOCK, sensed.shape[1] - first)
        for lane in range(size):
            column = first + lane
            rod_length, target = sensed[layout.SENSED_ROD_LENGTH, column], load_target(sensed, column)
            tracking = tracking_errors(state, column, rod_length, target)
            observe_state(state, column, tracking, lanes, lane)
        for lane in range(size):
            for field in STATE_COLUMNS:
                observation[first + lane, field] = lanes[field, lane]
        if observation.shape[1] > _USUAL:
            for lane in range(size):
                observe_measured(state, first + lane, sensed[layout.SENSED_AGE, first + lane], lanes, lane)
                for field in LAB_STATE_COLUMNS:
                    observation[first + lane, field] = lanes[field, lane]
