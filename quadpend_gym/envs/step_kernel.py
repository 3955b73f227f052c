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

from quadpend_gym.core.arrays import Floats, Floats32, Integers
from quadpend_gym.core.elementary import arcsin
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.envs.outcome import (
    AIR_VELOCITY,
    COMMAND,
    DISTURBANCE,
    OUTCOME_SIZE,
    PARAMETERS,
    REWARD,
    SEEN_STATE,
    TERMINATED,
    TILT,
    TRACKING_ERROR,
)
from quadpend_gym.physics.drag import add_drag
from quadpend_gym.physics.dynamics import (
    thrust_axis,
)
from quadpend_gym.physics.kernel import (
    BLOCK,
    DIVERGENCE_LIMIT,
    LANE_STATE_SIZE,
    THRUST_AXIS,
    gather,
    integrate,
    scatter,
)
from quadpend_gym.physics.parameters import PARAMETERS_SIZE, ROD_LENGTH
from quadpend_gym.physics.state import ACTION_SIZE, DIRECTION, EULER, POSITION, STATE_SIZE
from quadpend_gym.physics.vectors import Vec3, load, norm, store
from quadpend_gym.tasks.observation import (
    OBSERVATION_SIZE,
    REFERENCE_START,
    TARGET_SIZE,
    Target,
    TrackingErrors,
    load_target,
    observe_reference,
    observe_state,
    store_target,
    tracking_errors,
)
from quadpend_gym.tasks.references import REFERENCE_SIZE, reference_point
from quadpend_gym.tasks.rewards import reward_terms

# A row's memory: state, parameters and reference, from edge to edge.
MEMORY_EDGES = (0, *accumulate((STATE_SIZE, PARAMETERS_SIZE, REFERENCE_SIZE)))

# Edges of the parts of one buffer of lanes: outcome, target and rod's length, state with the thrust axis, action,
# reference, time.
_TARGET = OUTCOME_SIZE
_STATE, _ACTION, _REFERENCE, _TIME, _END = (
    _TARGET + size for size in accumulate((SEEN_STATE, LANE_STATE_SIZE, ACTION_SIZE, REFERENCE_SIZE, 1))
)


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
    return not (size < DIVERGENCE_LIMIT)


@inlined
def _over(state: Any, lane: int, error: Vec3, rod_length: float, limits: Any) -> bool:
    """Whether the state is past the task's limits; `limits` holds the two angles as cosines."""
    height, upright = state[POSITION + 2, lane], state[DIRECTION + 2, lane]
    return bool(
        (upright < limits[0])
        | (state[THRUST_AXIS + 2, lane] < limits[1])
        | (norm(error) > limits[2])
        | (min(height, height + rod_length * upright) <= limits[3])
    )


@inlined
def _measure(
    state: Any, action: Any, physics: Any, lane: int, tracking: TrackingErrors, limits: Any, weights: Any, out: Any
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
    buffer = np.empty((_END, BLOCK))
    disturbance_lanes, velocity_lanes = buffer[DISTURBANCE:AIR_VELOCITY], buffer[AIR_VELOCITY:PARAMETERS]
    physics_lanes, command_lanes = buffer[PARAMETERS:COMMAND], buffer[COMMAND:_TARGET]
    target_lanes, state_lanes = buffer[_TARGET:_STATE], buffer[_STATE:_ACTION]
    action_lanes, reference_lanes, time = buffer[_ACTION:_REFERENCE], buffer[_REFERENCE:_TIME], buffer[_TIME]
    observation_lanes = np.empty((OBSERVATION_SIZE, BLOCK), np.float32)
    diverged = np.empty(BLOCK, np.bool_)
    for first in range(0, state.shape[0], BLOCK):
        lanes = min(BLOCK, state.shape[0] - first)
        gather(state, first, lanes, state_lanes)
        gather(action, first, lanes, action_lanes)
        gather(parameters, first, lanes, physics_lanes)
        gather(reference, first, lanes, reference_lanes)
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
                store(state_lanes, THRUST_AXIS, lane, thrust_axis(load(state_lanes, EULER, lane)))
        for lane in range(lanes):
            point = reference_point(reference_lanes, lane, time[lane])
            observe_reference(point, lane, observation_lanes)
            target = Target(point.d0, point.d1, point.yaw)
            store_target(target, target_lanes, lane)
            target_lanes[TARGET_SIZE, lane] = physics_lanes[ROD_LENGTH, lane]
            tracking = tracking_errors(state_lanes, lane, physics_lanes[ROD_LENGTH, lane], target)
            _measure(state_lanes, action_lanes, physics_lanes, lane, tracking, limits, weights, buffer)
        for lane in range(lanes):
            if diverged[lane]:
                buffer[TERMINATED, lane] = 1.0
        scatter(state_lanes, first, lanes, state)
        _copy(buffer, lanes, outcome[:, first:])
        if sensed.shape[1] > 0:
            _copy(buffer[_TARGET:], lanes, sensed[:, first:])
            scatter(observation_lanes[REFERENCE_START:], first, lanes, observation[:, REFERENCE_START:])
        else:
            for lane in range(lanes):
                tracking = tracking_errors(
                    state_lanes, lane, physics_lanes[ROD_LENGTH, lane], load_target(target_lanes, lane)
                )
                observe_state(state_lanes, lane, tracking, observation_lanes, lane)
            scatter(observation_lanes, first, lanes, observation)
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
    state, lanes = sensed[SEEN_STATE:], np.empty((REFERENCE_START, BLOCK), np.float32)
    for first in range(0, sensed.shape[1], BLOCK):
        size = min(BLOCK, sensed.shape[1] - first)
        for lane in range(size):
            column = first + lane
            tracking = tracking_errors(state, column, sensed[TARGET_SIZE, column], load_target(sensed, column))
            observe_state(state, column, tracking, lanes, lane)
        for lane in range(size):
            for field in range(REFERENCE_START):
                observation[first + lane, field] = lanes[field, lane]
