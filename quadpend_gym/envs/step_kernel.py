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

from quadpend_gym.core.arrays import Ages, Booleans, Floats, Floats32, Integers
from quadpend_gym.core.elementary import arcsin, select
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.envs import kernel_layout as layout
from quadpend_gym.envs import outcome as rows
from quadpend_gym.envs.inputs import NO_ERROR, find_error
from quadpend_gym.physics.drag import add_drag
from quadpend_gym.physics.dynamics import thrust_axis
from quadpend_gym.physics.euler_kernel import (
    BLOCK,
    DIVERGENCE_LIMIT,
    LOOP_EFFICIENCY,
    THRUST_AXIS,
    commanded,
    gather,
    integrate_euler,
    scatter,
)
from quadpend_gym.physics.rigid_kernel import RIGID, RIGID_LANE_SIZE, RIGID_SIZE, integrate_rigid, store_present
from quadpend_gym.physics.rigid_settings import LOOP_SIZE, with_loop
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, DIRECTION_RATE, EULER, POSITION, STATE_SIZE
from quadpend_gym.physics.vectors import Vec3, load, load_four, norm, store, store_four
from quadpend_gym.tasks.observation import (
    ALL,
    STATE_COLUMNS,
    Target,
    TrackingErrors,
    load_target,
    observe_reference,
    observe_state,
    store_target,
    tracking_errors,
)
from quadpend_gym.tasks.references import POINT_SIZE, REFERENCE_SIZE, load_point, store_point
from quadpend_gym.tasks.rewards import reward, reward_terms
from quadpend_gym.tasks.trajectories import followed_at, reference_at
from quadpend_gym.vehicles.parameters import ROD_LENGTH
from quadpend_gym.wind import WIND_SIZE

# Parts of one buffer of shape (rows, lanes): the outcome, the sensed values followed by the thrust axis and the further
# state of rigid vehicles, the action, the reference and its point, and the time.
_SENSED = slice(rows.OUTCOME_SIZE, rows.OUTCOME_SIZE + layout.SENSED_SIZE)
_STATE, _ACTION, _REFERENCE, _POINT, _TIME, _END = accumulate(
    (rows.OUTCOME_SIZE + layout.SENSED_STATE.start, RIGID_LANE_SIZE, ACTION_SIZE, REFERENCE_SIZE, POINT_SIZE, 1)
)
_OBSERVED = ALL.size  # rows of the buffer of the observation
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
def is_outside(state: Any, lane: int, error: Vec3, rod_length: float, limits: layout.KernelLimits) -> float:
    """Return 1 if the state is outside the task's limits, else 0."""
    height, vertical = state[POSITION + 2, lane], state[DIRECTION + 2, lane]
    found = select(min(height, height + limits.reach * rod_length * vertical) <= limits.ground, 1.0, 0.0)
    found = select(norm(error) > limits.tracking_error, 1.0, found)
    found = select(state[THRUST_AXIS + 2, lane] < limits.cos_body_angle, 1.0, found)
    return select(limits.side * vertical < limits.cos_pendulum_angle, 1.0, found)


@inlined
def _measure(
    state: Any, action: Any, rod_length: float, lane: int, tracking: TrackingErrors, settings: Any, out: Any
) -> None:
    """Write reward, termination, tracking error and tilt into column `lane` of an outcome."""
    r, limits, weights = load(state, DIRECTION, lane), settings.limits, settings.weights
    cosine = limits.side * r.z
    terms = reward_terms(tracking.error, cosine, tracking.yaw_error, action, lane, weights.tip)
    store_four(out, rows.TRACKING_TERM, lane, terms)
    store(out, _TRACKING_ERROR, lane, tracking.error)
    out[rows.TILT, lane] = 2.0 * arcsin(min(0.5 * norm(Vec3(r.x, r.y, r.z - limits.side)), 1.0))
    out[rows.REWARD, lane] = reward(terms, cosine, load(state, DIRECTION_RATE, lane), weights)
    out[rows.TERMINATED, lane] = is_outside(state, lane, tracking.error, rod_length, limits)


@inlined
def _run(
    stages: int,
    memory: Any,
    clock: Any,
    columns: Any,
    action: Any,
    ages: Any,
    loops: Any,
    trajectories: Any,
    task: layout.KernelSettings,
    rigid: Any,
    diverged: Any,
    observation: Any,
    outcome: Any,
    begin: int,
    end: int,
) -> int:
    """Do stages of a control step, as `run_euler` describes; `rigid` is a `RigidSettings`, or None without one."""
    wind, sensed = columns[:WIND_SIZE], columns[WIND_SIZE:]
    begin = max(begin, 0)  # tells the compiler that indices of sub-environments are not negative
    error = find_error(action[begin:end], wind[:, begin:end])
    if error != NO_ERROR:
        return error + begin if error > NO_ERROR else error - begin
    state, parameters = memory[:, layout.MEMORY_STATE], memory[:, layout.MEMORY_PARAMETERS]
    reference, period, substeps = memory[:, layout.MEMORY_REFERENCE], task.period, task.substeps
    buffer = np.empty((_END, BLOCK))
    disturbance_lanes, velocity_lanes = buffer[rows.DISTURBANCE], buffer[rows.AIR_VELOCITY]
    physics_lanes, command_lanes = buffer[rows.PARAMETERS], buffer[rows.COMMAND]
    sensed_lanes, state_lanes, action_lanes = buffer[_SENSED], buffer[_STATE:_ACTION], buffer[_ACTION:_REFERENCE]
    reference_lanes, point_lanes, time = buffer[_REFERENCE:_POINT], buffer[_POINT:_TIME], buffer[_TIME]
    observation_lanes = np.empty((_OBSERVED, BLOCK), np.float32)
    lost = np.empty(BLOCK)
    loop_lanes, age_lanes = np.empty((LOOP_SIZE, BLOCK)), np.empty((ages.shape[0], BLOCK), np.int16)
    if rigid is None:
        under_way = memory[:, layout.MEMORY_SIZE :]
    else:
        rigid_memory, under_way = memory[:, layout.MEMORY_RIGID], memory[:, layout.MEMORY_RIGID.stop :]
    issued = np.empty((under_way.shape[1] + ACTION_SIZE, BLOCK))
    for first in range(begin, end, BLOCK):
        lanes = min(BLOCK, end - first)
        gather(state, first, lanes, state_lanes)
        gather(action, first, lanes, action_lanes)
        gather(parameters, first, lanes, physics_lanes)
        _copy(wind[:, first:], lanes, buffer[_WIND])
        _copy(loops[:, first:], lanes, loop_lanes)
        if rigid is not None:
            gather(rigid_memory, first, lanes, state_lanes[RIGID:])
        if stages & ADVANCE:
            _copy(ages[:, first:], lanes, age_lanes)
            gather(under_way, first, lanes, issued)
            _copy(action_lanes, lanes, issued[under_way.shape[1] :])
            scatter(issued[ACTION_SIZE:], first, lanes, under_way)
            if rigid is None:
                if task.moves_air:
                    for lane in range(lanes):
                        add_drag(load(velocity_lanes, 0, lane), state_lanes, physics_lanes, lane, disturbance_lanes)
                integrate_euler(
                    state_lanes,
                    issued,
                    age_lanes,
                    loop_lanes,
                    disturbance_lanes,
                    physics_lanes,
                    task.command_scale,
                    lanes,
                    period,
                    substeps,
                    command_lanes,
                )
            else:
                integrate_rigid(
                    state_lanes,
                    issued,
                    age_lanes,
                    loop_lanes,
                    disturbance_lanes,
                    velocity_lanes,
                    physics_lanes,
                    rigid,
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
                    diverged[first + lane] = True
                    for field in range(STATE_SIZE):
                        state_lanes[field, lane] = state[first + lane, field]
                    store(state_lanes, THRUST_AXIS, lane, thrust_axis(load(state_lanes, EULER, lane)))
                    if rigid is not None:
                        for field in range(RIGID_SIZE):
                            state_lanes[RIGID + field, lane] = rigid_memory[first + lane, field]
            scatter(state_lanes, first, lanes, state)
            if rigid is not None:
                scatter(state_lanes[RIGID:], first, lanes, rigid_memory)
        elif rigid is None:
            for lane in range(lanes):
                store(state_lanes, THRUST_AXIS, lane, thrust_axis(load(state_lanes, EULER, lane)))
                efficiency = load_four(loop_lanes, LOOP_EFFICIENCY, lane)
                command = commanded(load_four(action_lanes, 0, lane), task.command_scale, efficiency)
                store_four(command_lanes, 0, lane, command)
        else:
            for lane in range(lanes):
                store_present(state_lanes, with_loop(rigid, loop_lanes, lane), lane, command_lanes)
        if stages & MEASURE:
            gather(reference, first, lanes, reference_lanes)
            for lane in range(lanes):
                time[lane] = period * clock[first + lane]
            for lane in range(lanes):
                store_point(reference_at(reference_lanes, lane, time[lane]), lane, point_lanes)
            if trajectories.shape[0] > 0:
                for lane in range(lanes):
                    followed = int(memory[first + lane, layout.MEMORY_TRAJECTORY])
                    if followed >= 0:
                        store_point(followed_at(trajectories, followed, time[lane]), lane, point_lanes)
            for lane in range(lanes):
                point = load_point(point_lanes, lane)
                observe_reference(point, lane, observation_lanes)
                target = Target(point.d0, point.d1, point.yaw)
                store_target(target, sensed_lanes, lane)
                sensed_lanes[layout.SENSED_ROD_LENGTH, lane] = physics_lanes[ROD_LENGTH, lane]
                tracking = tracking_errors(state_lanes, lane, physics_lanes[ROD_LENGTH, lane], target)
                _measure(state_lanes, action_lanes, physics_lanes[ROD_LENGTH, lane], lane, tracking, task, buffer)
            for lane in range(lanes):
                if diverged[first + lane]:
                    buffer[rows.TERMINATED, lane] = 1.0
                    diverged[first + lane] = False
            _copy(buffer, lanes, outcome[:, first:])
            if task.has_sensors:
                _copy(sensed_lanes, lanes, sensed[:, first:])
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
    ages: Ages,
    loops: Floats,
    trajectories: Floats,
    settings: Floats,
    diverged: Booleans,
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
        memory: State, parameters, reference and actions under way of each sub-environment, shape (n, k), see
            `kernel_layout`; changed in place.
        clock: Control steps since each episode began, shape (n,), changed in place.
        columns: Wind over the control period, laid out as in `quadpend_gym.wind`, shape (12, n). With sensors 26
            further rows, an output: `observe_sensed` then writes the state's part of the observation, once the
            sensors have changed the state in these rows.
        action: Shape (n, 4), each component in [−1, 1]; the reward counts it, even where it acts later.
        ages: Control steps since the action that acts in each substep was issued, shape (s, n).
        loops: Numbers of the loop, shape (10, n), see `rigid_settings`.
        trajectories: `TrajectoryTable.numbers`.
        settings: A packed `KernelSettings`.
        diverged: Whether the state has diverged since the last `MEASURE`, shape (n,), changed in place.
        observation: Output, shape (n, m), laid out as `quadpend_gym.tasks.observation.ALL`.
        outcome: Output, shape (k, at least n): the first k rows of `outcome`.
        begin: A multiple of 64.
        end: A multiple of 64, or n.

    Returns:
        The error code of `inputs`; with an error, no array is changed.
    """
    task, arrays = layout.unpack_settings(settings), (memory, clock, columns, action, ages, loops, trajectories)
    return int(_run(stages, *arrays, task, None, diverged, observation, outcome, begin, end))


@compiled
def run_rigid(
    stages: int,
    memory: Floats,
    clock: Integers,
    columns: Floats,
    action: Floats32,
    ages: Ages,
    loops: Floats,
    trajectories: Floats,
    settings: Floats,
    diverged: Booleans,
    observation: Floats32,
    outcome: Floats,
    begin: int,
    end: int,
) -> int:
    """As `run_euler`, for rigid vehicles; `settings` are a packed `RigidStepSettings`."""
    task, arrays = layout.unpack_rigid_settings(settings), (memory, clock, columns, action, ages, loops, trajectories)
    return int(_run(stages, *arrays, task.kernel, task.vehicle, diverged, observation, outcome, begin, end))


@compiled
def observe_sensed(columns: Floats, observation: Floats32) -> None:
    """Write the part of the observation, shape (n, m), that depends on the state, from the sensed state.

    `columns` is the array that a step has written and the sensors have changed, shape (38, n).
    """
    sensed = columns[WIND_SIZE:]
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
