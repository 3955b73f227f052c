"""The compiled control step of n sub-environments: action, wind and drag, integration, measurement, observation.

The step reads and writes plain arrays: the memory and the settings (`kernel_layout`), the outcome (`outcome`), the
observation (`quadpend_gym.tasks.observation`) and the wind (`quadpend_gym.wind`). For each sub-environment it

1. converts the action a to the command u = s_u (1 + a₀), τᵢ = sᵢ aᵢ for i = 1, 2, 3 (`Simulation.command_scale`),
2. adds the wind's forces and torque, and drag if the wind has a velocity (`quadpend_gym.physics.drag`),
3. integrates the equations of motion over one control period (`quadpend_gym.physics.euler_kernel`; rigid vehicles do 1
   to 3 in `quadpend_gym.physics.rigid_kernel`),
4. evaluates the reference at the new time and measures tracking errors, reward terms and termination,
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
from quadpend_gym.physics.drag import add_drag
from quadpend_gym.physics.dynamics import thrust_axis
from quadpend_gym.physics.euler_kernel import (
    BLOCK,
    DIVERGENCE_LIMIT,
    THRUST_AXIS,
    gather,
    integrate,
    scatter,
    store_command,
)
from quadpend_gym.physics.rigid_kernel import RIGID, RIGID_LANE_SIZE, RIGID_SIZE, integrate_rigid, store_wrench
from quadpend_gym.physics.rigid_settings import LOOP_SIZE, LOOP_THRUST, with_loop
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, DIRECTION_RATE, EULER, POSITION, STATE_SIZE
from quadpend_gym.physics.vectors import Vec3, load, norm, store, store_four, times
from quadpend_gym.tasks.observation import (
    OBSERVATION_SIZE,
    REFERENCE_START,
    Target,
    TrackingErrors,
    load_target,
    observe_reference,
    observe_state,
    store_target,
    tracking_errors,
)
from quadpend_gym.tasks.references import REFERENCE_SIZE
from quadpend_gym.tasks.rewards import reward, reward_terms
from quadpend_gym.tasks.trajectories import point_at
from quadpend_gym.vehicles.parameters import ROD_LENGTH
from quadpend_gym.wind import WIND_SIZE

# Parts of one buffer of shape (rows, lanes): the outcome, the sensed values followed by the thrust axis and the further
# state of rigid vehicles, the action, the reference and the time.
_SENSED = slice(rows.OUTCOME_SIZE, rows.OUTCOME_SIZE + layout.SENSED_SIZE)
_STATE, _ACTION, _REFERENCE, _TIME, _END = accumulate(
    (rows.OUTCOME_SIZE + layout.SENSED_STATE.start, RIGID_LANE_SIZE, ACTION_SIZE, REFERENCE_SIZE, 1)
)
_WIND = slice(rows.DISTURBANCE.start, rows.AIR_VELOCITY.stop)
_TRACKING_ERROR = rows.TRACKING_ERROR.start  # first row, for `store`


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
def diverged(state: Any, lane: int) -> float:
    """Return 1 if a state is not finite or too large, else 0."""
    size = 0.0
    for field in range(STATE_SIZE):
        size = size + abs(state[field, lane])
    return select(size < DIVERGENCE_LIMIT, 0.0, 1.0)


@inlined
def outside(state: Any, lane: int, error: Vec3, rod_length: float, limits: layout.KernelLimits) -> float:
    """Return 1 if the state is outside the task's limits, else 0."""
    height, vertical = state[POSITION + 2, lane], state[DIRECTION + 2, lane]
    found = select(min(height, height + rod_length * vertical) <= limits.ground, 1.0, 0.0)
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
    out[rows.TERMINATED, lane] = outside(state, lane, tracking.error, rod_length, limits)


@inlined
def _step(
    memory: Any,
    clock: Any,
    columns: Any,
    action: Any,
    task: layout.KernelSettings,
    observation: Any,
    outcome: Any,
    trajectories: Any,
    rigid: Any,
    loops: Any,
    begin: int,
    end: int,
) -> int:
    """Advance the sub-environments begin ≤ i < end, as `step_euler` describes.

    `trajectories` is (numbers, first) or None; `rigid` is a `RigidStepSettings`, or None for the paper's vehicle;
    `loops` is that of `step_euler_drawn`, or None.
    """
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
    sensed_lanes, state_lanes = buffer[_SENSED], buffer[_STATE:_ACTION]
    action_lanes, reference_lanes, time = buffer[_ACTION:_REFERENCE], buffer[_REFERENCE:_TIME], buffer[_TIME]
    observation_lanes = np.empty((OBSERVATION_SIZE, BLOCK), np.float32)
    is_lost = np.empty(BLOCK, np.bool_)
    last_action, last_lanes, switch = memory[:, layout.MEMORY_ACTION], np.empty((ACTION_SIZE, BLOCK)), task.switch
    if rigid is not None:
        rigid_memory = memory[:, layout.MEMORY_RIGID]
    loop_lanes: Any = None if loops is None else np.empty((loops.shape[0], BLOCK))
    for first in range(begin, end, BLOCK):
        lanes = min(BLOCK, end - first)
        gather(state, first, lanes, state_lanes)
        gather(action, first, lanes, action_lanes)
        gather(parameters, first, lanes, physics_lanes)
        gather(reference, first, lanes, reference_lanes)
        _copy(wind[:, first:], lanes, buffer[_WIND])
        if loops is not None:
            _copy(loops[:, first:], lanes, loop_lanes)
        if switch > 0:
            gather(last_action, first, lanes, last_lanes)
            scatter(action_lanes, first, lanes, last_action)
        if rigid is None:
            if task.moves_air:
                for lane in range(lanes):
                    add_drag(load(velocity_lanes, 0, lane), state_lanes, physics_lanes, lane, disturbance_lanes)
            if loops is None:
                for part in range(0 if min(switch, substeps) > 0 else 1, 2):  # the last action, then this one
                    acting, count = (last_lanes, switch) if part == 0 else (action_lanes, max(substeps - switch, 0))
                    for lane in range(lanes):
                        store_command(acting, task.command_scale, lane, command_lanes)
                    time_of_part = period if count == substeps else period * count / substeps
                    integrate(state_lanes, command_lanes, disturbance_lanes, physics_lanes, lanes, time_of_part, count)
            else:
                h, count = period / max(substeps, 1), min(substeps, 1)
                for substep in range(max(substeps, 1)):
                    acting = loop_lanes[LOOP_SIZE + ACTION_SIZE * substep :]
                    for lane in range(lanes):
                        command_scale = times(loop_lanes[LOOP_THRUST, lane], task.command_scale)
                        store_command(acting, command_scale, lane, command_lanes)
                    integrate(state_lanes, command_lanes, disturbance_lanes, physics_lanes, lanes, h, count)
        else:
            gather(rigid_memory, first, lanes, state_lanes[RIGID:])
            integrate_rigid(
                state_lanes,
                last_lanes,
                action_lanes,
                disturbance_lanes,
                velocity_lanes,
                physics_lanes,
                rigid.vehicle,
                lanes,
                period,
                substeps,
                switch,
                loop_lanes,
            )
            for lane in range(lanes):
                store_wrench(state_lanes, with_loop(rigid.vehicle, loop_lanes, lane), lane, command_lanes)
        for lane in range(lanes):
            is_lost[lane] = diverged(state_lanes, lane) > 0.0
        for lane in range(lanes):
            clock[first + lane] += min(substeps, 1)
            time[lane] = period * clock[first + lane]
            if is_lost[lane]:
                for field in range(STATE_SIZE):
                    state_lanes[field, lane] = state[first + lane, field]
                store(state_lanes, THRUST_AXIS, lane, thrust_axis(load(state_lanes, EULER, lane)))
                if rigid is not None:
                    for field in range(RIGID_SIZE):
                        state_lanes[RIGID + field, lane] = rigid_memory[first + lane, field]
        for lane in range(lanes):
            point = point_at(trajectories, first + lane, reference_lanes, lane, time[lane])
            observe_reference(point, lane, observation_lanes)
            target = Target(point.d0, point.d1, point.yaw)
            store_target(target, sensed_lanes, lane)
            sensed_lanes[layout.SENSED_ROD_LENGTH, lane] = physics_lanes[ROD_LENGTH, lane]
            tracking = tracking_errors(state_lanes, lane, physics_lanes[ROD_LENGTH, lane], target)
            _measure(state_lanes, action_lanes, physics_lanes[ROD_LENGTH, lane], lane, tracking, task, buffer)
        for lane in range(lanes):
            if is_lost[lane]:
                buffer[rows.TERMINATED, lane] = 1.0
        scatter(state_lanes, first, lanes, state)
        if rigid is not None:
            scatter(state_lanes[RIGID:], first, lanes, rigid_memory)
        _copy(buffer, lanes, outcome[:, first:])
        if sensed.shape[0] > 0:
            _copy(sensed_lanes, lanes, sensed[:, first:])
            scatter(observation_lanes[REFERENCE_START:], first, lanes, observation[:, REFERENCE_START:])
        else:
            for lane in range(lanes):
                tracking = tracking_errors(
                    state_lanes, lane, physics_lanes[ROD_LENGTH, lane], load_target(sensed_lanes, lane)
                )
                observe_state(state_lanes, lane, tracking, observation_lanes, lane)
            scatter(observation_lanes, first, lanes, observation)
    return NO_ERROR


@inlined
def _step_euler(
    loops: Any,
    memory: Any,
    clock: Any,
    columns: Any,
    action: Any,
    settings: Any,
    observation: Any,
    outcome: Any,
    begin: int,
    end: int,
) -> int:
    task = layout.unpack_settings(settings)
    if settings.size == layout.SETTINGS_SIZE:
        return _step(memory, clock, columns, action, task, observation, outcome, None, None, loops, begin, end)
    trajectories = settings[layout.SETTINGS_SIZE :], memory[:, layout.MEMORY_TRAJECTORY]
    return _step(memory, clock, columns, action, task, observation, outcome, trajectories, None, loops, begin, end)


@inlined
def _step_rigid(
    loops: Any,
    memory: Any,
    clock: Any,
    columns: Any,
    action: Any,
    settings: Any,
    observation: Any,
    outcome: Any,
    begin: int,
    end: int,
) -> int:
    rigid = layout.unpack_rigid_settings(settings)
    task = rigid.kernel
    if settings.size == layout.RIGID_SETTINGS_SIZE:
        return _step(memory, clock, columns, action, task, observation, outcome, None, rigid, loops, begin, end)
    trajectories = settings[layout.RIGID_SETTINGS_SIZE :], memory[:, layout.MEMORY_TRAJECTORY]
    return _step(memory, clock, columns, action, task, observation, outcome, trajectories, rigid, loops, begin, end)


@compiled
def step_euler(
    memory: Floats,
    clock: Integers,
    columns: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    begin: int,
    end: int,
) -> int:
    """Advance the sub-environments begin ≤ i < end of n by one control period, and compute outcome and observation.

    With 0 substeps the state does not change.

    If the state of a sub-environment diverges, it is reset to its value before the step, and the episode terminates.

    Args:
        memory: State, parameters and reference of each sub-environment, shape (n, 52), see `kernel_layout`. The state
            is changed in place.
        clock: Control steps since each episode began, shape (n,), changed in place.
        columns: Wind over the control period, laid out as in `quadpend_gym.wind`, shape (12, n). With sensors 26
            further rows, an output: the step then writes only the reference's part of the observation, and
            `observe_sensed` the other part once the sensors have changed the state in these rows.
        action: Shape (n, 4), each component in [−1, 1].
        settings: A packed `KernelSettings`; then packed trajectories, if a sub-environment follows one.
        observation: Output, shape (n, 36).
        outcome: Output, shape (k, at least n): the first k rows of `outcome`.
        begin: A multiple of 64.
        end: A multiple of 64, or n.

    Returns:
        The error code of `inputs`; with an error, no array is changed.
    """
    return _step_euler(None, memory, clock, columns, action, settings, observation, outcome, begin, end)


@compiled
def step_rigid(
    memory: Floats,
    clock: Integers,
    columns: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    begin: int,
    end: int,
) -> int:
    """As `step_euler`, for rigid vehicles: `memory` has shape (n, 63), `settings` are a packed `RigidStepSettings`."""
    return _step_rigid(None, memory, clock, columns, action, settings, observation, outcome, begin, end)


@compiled
def step_euler_drawn(loops: Floats, *arguments: Any) -> int:
    """As `step_euler`, with `LoopRows.columns`, shape (7 + 4 s, n); `action` must be the last one in it."""
    return int(_step_euler(loops, *arguments))


@compiled
def step_rigid_drawn(loops: Floats, *arguments: Any) -> int:
    """As `step_euler_drawn`, for rigid vehicles."""
    return int(_step_rigid(loops, *arguments))


@compiled
def observe_sensed(columns: Floats, observation: Floats32) -> None:
    """Write the part of the observation, shape (n, 36), that depends on the state, from the sensed state.

    `columns` is the array that a step has written and the sensors have changed, shape (38, n).
    """
    sensed = columns[WIND_SIZE:]
    state, lanes = sensed[layout.SENSED_STATE], np.empty((REFERENCE_START, BLOCK), np.float32)
    for first in range(0, sensed.shape[1], BLOCK):
        size = min(BLOCK, sensed.shape[1] - first)
        for lane in range(size):
            column = first + lane
            rod_length, target = sensed[layout.SENSED_ROD_LENGTH, column], load_target(sensed, column)
            tracking = tracking_errors(state, column, rod_length, target)
            observe_state(state, column, tracking, lanes, lane)
        for lane in range(size):
            for field in range(REFERENCE_START):
                observation[first + lane, field] = lanes[field, lane]
