"""The compiled loops over sub-environments: integration, measurement, and the start of episodes.

Rows are worked on in blocks of 64, copied into (field, lane) buffers so that each loop over lanes becomes vector
instructions; a batch of one takes the same path, so its numbers are the same bits.

One substep of length h integrates with the classical Runge–Kutta method (RK4), in coordinates in which most of it is
done exactly (see `dynamics` for the equations):

    attitude         a quadratic in time, since τ is held over a control period
    centre of mass   Ẍ depends on time alone: RK4 is Simpson's rule
    pendulum         RK4 for (r, ṙ), with the pull w at t, t + h/2 and t + h

Afterwards r is normalised and ṙ projected onto its tangent plane. The thrust axis at the end of a substep is kept for
the start of the next, so a substep takes two evaluations of the angles' sines.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from quadpend_gym.arrays import Floats, Floats32, Integers
from quadpend_gym.drag import add_drag
from quadpend_gym.dynamics import (
    centre_acceleration,
    centre_offset,
    direction_acceleration,
    euler_acceleration,
    load_physics,
    rod_pull,
    thrust_axis,
)
from quadpend_gym.elementary import arcsin
from quadpend_gym.jit import compiled, inlined
from quadpend_gym.observation import (
    OBSERVATION_SIZE,
    STATE_PART,
    TARGET_SIZE,
    Target,
    Tracking,
    load_target,
    observe_reference,
    observe_state,
    store_target,
    track,
)
from quadpend_gym.params import PHYSICS_SIZE, ROD_LENGTH
from quadpend_gym.references import REFERENCE_SIZE, reference_point
from quadpend_gym.reward import reward_terms
from quadpend_gym.state import DIRECTION, DIRECTION_RATE, EULER, EULER_RATE, POSITION, STATE_SIZE, VELOCITY
from quadpend_gym.vectors import Vec3, add, axpy, dot, load, norm, scale, store

ACTION_SIZE, COMMAND_SIZE, DISTURBANCE_SIZE = 4, 4, 9
# A row's memory: state, parameters and reference, from edge to edge.
MEMORY_EDGES = (0, *accumulate((STATE_SIZE, PHYSICS_SIZE, REFERENCE_SIZE)))
# Rows of the outcome of a step, of which it has as many as are asked for: the four reward terms, the tracking error and
# so on, and what acted.
_ROWS = (4, 3, 1, 1, 1, DISTURBANCE_SIZE, 3, PHYSICS_SIZE, COMMAND_SIZE)
_, TRACKING_ERROR, TILT, REWARD, TERMINATED, DISTURBANCE, AIR_VELOCITY, PARAMETERS, COMMAND, OUTCOME_SIZE = (
    0,
    *accumulate(_ROWS),
)
# What sensors see: the target and the rod's length, which a tracking error is made of, and from here on the state.
SEEN_STATE = TARGET_SIZE + 1
SENSED_SIZE = SEEN_STATE + STATE_SIZE

_BLOCK = 64
_AXIS = STATE_SIZE
LANE_STATE = STATE_SIZE + 3
# Edges of the parts of one buffer of lanes: outcome, target and rod's length, state with the thrust axis, action,
# reference, time.
_TARGET = OUTCOME_SIZE
_STATE, _ACTION, _REFERENCE, _TIME, _END = (
    _TARGET + size for size in accumulate((SEEN_STATE, LANE_STATE, ACTION_SIZE, REFERENCE_SIZE, 1))
)
DIVERGED = 1e6  # a state this large is no longer a state


@inlined
def _euler_after(euler: Vec3, rate: Vec3, acceleration: Vec3, time: float) -> Vec3:
    return axpy(time, axpy(0.5 * time, acceleration, rate), euler)


@inlined
def _substep(state: Any, command: Any, disturbance: Any, physics_lanes: Any, lane: int, h: float) -> None:
    physics = load_physics(physics_lanes, lane)
    thrust = command[0, lane]
    quadrotor_force, bob_force = load(disturbance, 0, lane), load(disturbance, 3, lane)

    euler, euler_rate = load(state, EULER, lane), load(state, EULER_RATE, lane)
    euler_ddot = euler_acceleration(add(load(command, 1, lane), load(disturbance, 6, lane)), physics)
    euler_end = _euler_after(euler, euler_rate, euler_ddot, h)
    axis_end = thrust_axis(euler_end)
    force_0 = axpy(thrust, load(state, _AXIS, lane), quadrotor_force)
    force_m = axpy(thrust, thrust_axis(_euler_after(euler, euler_rate, euler_ddot, 0.5 * h)), quadrotor_force)
    force_1 = axpy(thrust, axis_end, quadrotor_force)

    pull_m = rod_pull(force_m, bob_force, physics)
    r, v1 = load(state, DIRECTION, lane), load(state, DIRECTION_RATE, lane)
    a1 = direction_acceleration(r, v1, rod_pull(force_0, bob_force, physics))
    v2 = axpy(0.5 * h, a1, v1)
    a2 = direction_acceleration(axpy(0.5 * h, v1, r), v2, pull_m)
    v3 = axpy(0.5 * h, a2, v1)
    a3 = direction_acceleration(axpy(0.5 * h, v2, r), v3, pull_m)
    v4 = axpy(h, a3, v1)
    a4 = direction_acceleration(axpy(h, v3, r), v4, rod_pull(force_1, bob_force, physics))
    r_end = axpy(h / 6.0, add(add(v1, v4), scale(2.0, add(v2, v3))), r)
    v_end = axpy(h / 6.0, add(add(a1, a4), scale(2.0, add(a2, a3))), v1)
    r_end = scale(1.0 / norm(r_end), r_end)
    v_end = axpy(-dot(r_end, v_end), r_end, v_end)

    offset = centre_offset(physics)
    centre = axpy(offset, r, load(state, POSITION, lane))
    centre_rate = axpy(offset, v1, load(state, VELOCITY, lane))
    c0 = centre_acceleration(force_0, bob_force, physics)
    cm = centre_acceleration(force_m, bob_force, physics)
    c1 = centre_acceleration(force_1, bob_force, physics)
    centre = axpy(h * h / 6.0, axpy(2.0, cm, c0), axpy(h, centre_rate, centre))
    centre_rate = axpy(h / 6.0, axpy(4.0, cm, add(c0, c1)), centre_rate)

    store(state, POSITION, lane, axpy(-offset, r_end, centre))
    store(state, VELOCITY, lane, axpy(-offset, v_end, centre_rate))
    store(state, EULER, lane, euler_end)
    store(state, EULER_RATE, lane, axpy(h, euler_ddot, euler_rate))
    store(state, DIRECTION, lane, r_end)
    store(state, DIRECTION_RATE, lane, v_end)
    store(state, _AXIS, lane, axis_end)


@inlined
def _gather(rows: Any, first: int, lanes: int, out: Any) -> None:
    for lane in range(lanes):
        for field in range(rows.shape[1]):
            out[field, lane] = rows[first + lane, field]


@inlined
def _scatter(lanes_in: Any, first: int, lanes: int, out: Any) -> None:
    for lane in range(lanes):
        for field in range(out.shape[1]):
            out[first + lane, field] = lanes_in[field, lane]


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
def integrate(
    state: Any, command: Any, disturbance: Any, physics: Any, lanes: int, period: float, substeps: int
) -> None:
    """As `advance`, on (field, lane) buffers; three more rows of `state` take the thrust axis, see `LANE_STATE`."""
    for lane in range(lanes):
        store(state, _AXIS, lane, thrust_axis(load(state, EULER, lane)))
    for _ in range(substeps):
        for lane in range(lanes):
            _substep(state, command, disturbance, physics, lane, period / substeps)


@compiled
def advance(
    state: Floats, command: Floats, disturbance: Floats, parameters: Floats, period: float, substeps: int
) -> None:
    """Physics alone: advance n states by `period`, in place.

    Args:
        state: shape (n, 18), laid out as in `quadpend_gym.state`.
        command: thrust (N) and torques τφ, τθ, τψ (N·m), held over the period, shape (n, 4).
        disturbance: d_Q (N), d_B (N), d_τ (N·m), world frame, held over the period, shape (n, 9).
        parameters: rows of `Parameters.as_array`, shape (n, 9).
        period: s.
        substeps: number of Runge–Kutta steps the period is divided into.
    """
    buffer = np.empty((_END, _BLOCK))
    state_lanes, command_lanes = buffer[_STATE:_ACTION], buffer[COMMAND:_TARGET]
    disturbance_lanes, physics_lanes = buffer[DISTURBANCE:AIR_VELOCITY], buffer[PARAMETERS:COMMAND]
    for first in range(0, state.shape[0], _BLOCK):
        lanes = min(_BLOCK, state.shape[0] - first)
        _gather(state, first, lanes, state_lanes)
        _gather(command, first, lanes, command_lanes)
        _gather(disturbance, first, lanes, disturbance_lanes)
        _gather(parameters, first, lanes, physics_lanes)
        integrate(state_lanes, command_lanes, disturbance_lanes, physics_lanes, lanes, period, substeps)
        _scatter(state_lanes, first, lanes, state)


@inlined
def _command(action: Any, scale: Any, lanes: int, out: Any) -> None:
    for lane in range(lanes):
        out[0, lane] = scale[0] * (1.0 + action[0, lane])
        out[1, lane] = scale[1] * action[1, lane]
        out[2, lane] = scale[2] * action[2, lane]
        out[3, lane] = scale[3] * action[3, lane]


@inlined
def _diverged(state: Any, lane: int) -> bool:
    size = 0.0
    for field in range(STATE_SIZE):
        size = size + abs(state[field, lane])
    return not (size < DIVERGED)


@inlined
def _over(state: Any, lane: int, error: Vec3, rod_length: float, limits: Any) -> bool:
    """Whether the state is past the task's limits; `limits` holds the two angles as cosines."""
    height, upright = state[POSITION + 2, lane], state[DIRECTION + 2, lane]
    return bool(
        (upright < limits[0])
        | (state[_AXIS + 2, lane] < limits[1])
        | (norm(error) > limits[2])
        | (min(height, height + rod_length * upright) <= limits[3])
    )


@inlined
def _measure(
    state: Any, action: Any, physics: Any, lane: int, tracking: Tracking, limits: Any, weights: Any, out: Any
) -> None:
    """Write reward, termination and measurements into column `lane` of a (10, n) buffer."""
    r = load(state, DIRECTION, lane)
    terms = reward_terms(tracking.error, r.z, tracking.yaw_error, action, lane, weights[4])
    out[0, lane] = terms.tracking
    out[1, lane] = terms.upright
    out[2, lane] = terms.yaw
    out[3, lane] = terms.effort
    store(out, TRACKING_ERROR, lane, tracking.error)
    out[TILT, lane] = 2.0 * arcsin(min(0.5 * norm(Vec3(r.x, r.y, r.z - 1.0)), 1.0))
    out[REWARD, lane] = (
        weights[0] * terms.tracking + weights[1] * terms.upright + weights[2] * terms.yaw + weights[3] * terms.effort
    )
    over = _over(state, lane, tracking.error, physics[ROD_LENGTH, lane], limits)
    out[TERMINATED, lane] = 1.0 if over else 0.0


@inlined
def _first_bad(action: Any, wind: Any) -> int:
    for row in range(action.shape[0]):
        for component in range(ACTION_SIZE):
            if not (abs(action[row, component]) <= 1.0):
                return row
    bad = False
    for number in wind.reshape(-1):
        bad |= not np.isfinite(number)
    if bad:
        for row in range(wind.shape[1]):
            for component in range(wind.shape[0]):
                if not np.isfinite(wind[component, row]):
                    return -2 - row
    return -1


@compiled
def first_bad(action: Floats32, wind: Floats) -> int:
    """The first row of actions, shape (n, 4), that is out of range or not finite.

    If there is none, −2 minus the first column of a wind, shape (12, n), that is not finite; if there is none, −1.
    """
    return _first_bad(action, wind)


@inlined
def _step(
    memory: Any, clock: Any, wind: Any, action: Any, settings: Any, observation: Any, outcome: Any, sensed: Any
) -> int:
    bad = _first_bad(action, wind)
    if bad != -1:
        return bad
    state = memory[:, MEMORY_EDGES[0] : MEMORY_EDGES[1]]
    parameters = memory[:, MEMORY_EDGES[1] : MEMORY_EDGES[2]]
    reference = memory[:, MEMORY_EDGES[2] : MEMORY_EDGES[3]]
    period, command_scale, limits, weights = settings[0], settings[1:5], settings[5:9], settings[9:14]
    air, substeps = settings[14] > 0.0, int(settings[15])
    buffer = np.empty((_END, _BLOCK))
    disturbance_lanes, velocity_lanes = buffer[DISTURBANCE:AIR_VELOCITY], buffer[AIR_VELOCITY:PARAMETERS]
    physics_lanes, command_lanes = buffer[PARAMETERS:COMMAND], buffer[COMMAND:_TARGET]
    target_lanes, state_lanes = buffer[_TARGET:_STATE], buffer[_STATE:_ACTION]
    action_lanes, reference_lanes, time = buffer[_ACTION:_REFERENCE], buffer[_REFERENCE:_TIME], buffer[_TIME]
    observation_lanes = np.empty((OBSERVATION_SIZE, _BLOCK), np.float32)
    diverged = np.empty(_BLOCK, np.bool_)
    for first in range(0, state.shape[0], _BLOCK):
        lanes = min(_BLOCK, state.shape[0] - first)
        _gather(state, first, lanes, state_lanes)
        _gather(action, first, lanes, action_lanes)
        _gather(parameters, first, lanes, physics_lanes)
        _gather(reference, first, lanes, reference_lanes)
        _command(action_lanes, command_scale, lanes, command_lanes)
        _copy(wind[:, first:], lanes, buffer[DISTURBANCE:PARAMETERS])
        if air:
            for lane in range(lanes):
                add_drag(load(velocity_lanes, 0, lane), state_lanes, physics_lanes, lane, disturbance_lanes)
        integrate(state_lanes, command_lanes, disturbance_lanes, physics_lanes, lanes, period, substeps)
        for lane in range(lanes):
            diverged[lane] = _diverged(state_lanes, lane)
        for lane in range(lanes):
            clock[first + lane] += min(substeps, 1)
            time[lane] = period * clock[first + lane]
            if diverged[lane]:
                for field in range(STATE_SIZE):
                    state_lanes[field, lane] = state[first + lane, field]
                store(state_lanes, _AXIS, lane, thrust_axis(load(state_lanes, EULER, lane)))
        for lane in range(lanes):
            point = reference_point(reference_lanes, lane, time[lane])
            observe_reference(point, lane, observation_lanes)
            target = Target(point.d0, point.d1, point.yaw)
            store_target(target, target_lanes, lane)
            target_lanes[TARGET_SIZE, lane] = physics_lanes[ROD_LENGTH, lane]
            tracking = track(state_lanes, lane, physics_lanes[ROD_LENGTH, lane], target)
            _measure(state_lanes, action_lanes, physics_lanes, lane, tracking, limits, weights, buffer)
        for lane in range(lanes):
            if diverged[lane]:
                buffer[TERMINATED, lane] = 1.0
        _scatter(state_lanes, first, lanes, state)
        _copy(buffer, lanes, outcome[:, first:])
        if sensed.shape[1] > 0:
            _copy(buffer[_TARGET:], lanes, sensed[:, first:])
            _scatter(observation_lanes[STATE_PART:], first, lanes, observation[:, STATE_PART:])
        else:
            for lane in range(lanes):
                tracking = track(state_lanes, lane, physics_lanes[ROD_LENGTH, lane], load_target(target_lanes, lane))
                observe_state(state_lanes, lane, tracking, observation_lanes, lane)
            _scatter(observation_lanes, first, lanes, observation)
    return -1


@compiled
def step(
    memory: Floats,
    clock: Integers,
    wind: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
) -> int:
    """One control period of n sub-environments, or with 0 substeps a look at them where they stand.

    A state that diverges is not kept: the row stays where it was and terminates.

    Args:
        memory: each row's state, parameters and reference side by side, shape (n, 47); see `MEMORY_EDGES`. The state
            is changed in place.
        clock: control steps since each episode began, shape (n,), changed in place.
        wind: as `quadpend_gym.wind` has it, shape (12, n).
        action: shape (n, 4), each component in [−1, 1].
        settings: `world.kernel_settings`: period, command scale (4), limits (4), reward weights (4) and tip, 1 if there
            is air or 0, and the number of Runge–Kutta steps in the period, or 0 to leave state and clock alone.
        observation: written, shape (n, 36).
        outcome: written, the rows above that it has, shape (k, at least n); the disturbance, drag included, is laid out
            as in `advance`.

    Returns:
        −1; or, with nothing done, what `first_bad` finds.
    """
    return _step(memory, clock, wind, action, settings, observation, outcome, outcome[:, :0])


@compiled
def step_sensed(
    memory: Floats,
    clock: Integers,
    wind: Floats,
    action: Floats32,
    settings: Floats,
    observation: Floats32,
    outcome: Floats,
    sensed: Floats,
) -> int:
    """As `step`, but it observes the reference only, and writes into `sensed`, shape (26, n), what sensors see."""
    return _step(memory, clock, wind, action, settings, observation, outcome, sensed)


@compiled
def observe_sensed(sensed: Floats, observation: Floats32) -> None:
    """Write into observations what they have of the state, from a sensed state instead of the true one.

    Args:
        sensed: as `step_sensed` writes it, its state then changed by sensors, shape (26, n).
        observation: changed, shape (n, 36).
    """
    state, lanes = sensed[SEEN_STATE:], np.empty((STATE_PART, _BLOCK), np.float32)
    for first in range(0, sensed.shape[1], _BLOCK):
        size = min(_BLOCK, sensed.shape[1] - first)
        for lane in range(size):
            column = first + lane
            tracking = track(state, column, sensed[TARGET_SIZE, column], load_target(sensed, column))
            observe_state(state, column, tracking, lanes, lane)
        for lane in range(size):
            for field in range(STATE_PART):
                observation[first + lane, field] = lanes[field, lane]
