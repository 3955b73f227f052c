"""The compiled rollout of `mppi`: the integration of the environment's kernel, with feedback and cost.

Each sampled trajectory of a row is one lane of the (field, lane) buffers, which `quadpend_gym.physics.euler_kernel`
describes.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from quadpend_baselines.modelling import linear_model
from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.euler_kernel import LANE_STATE_SIZE, THRUST_AXIS, integrate
from quadpend_gym.physics.state import (
    COMMAND_SIZE,
    DIRECTION,
    DIRECTION_RATE,
    DISTURBANCE_SIZE,
    EULER,
    POSITION,
    STATE_SIZE,
    VELOCITY,
)
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

MAX_SAMPLES = 64  # sampled trajectories of a row
# First fields in x of `linear_model`; roll, pitch, yaw and their rates are consecutive in x and in the state.
_X_POSITION, _X_VELOCITY = linear_model.POSITION.start, linear_model.VELOCITY.start
_X_EULER, _X_ANGLES_SIZE = linear_model.EULER.start, linear_model.EULER_RATE.stop - linear_model.EULER.start
_X_PENDULUM, _X_PENDULUM_RATE = linear_model.PENDULUM.start, linear_model.PENDULUM_RATE.start
# Ends of the parts of one buffer. For parts of one buffer, the compiler can prove that they do not overlap.
_STATE_END, _DEVIATION_END, _COMMAND_END, _CHANGE_END, _DISTURBANCE_END, _PARAMETERS_END, _END = accumulate(
    (LANE_STATE_SIZE, MODEL_STATE_SIZE, COMMAND_SIZE, COMMAND_SIZE, DISTURBANCE_SIZE, PARAMETERS_SIZE, 1)
)
BARRIER = 1e4  # cost per squared violation of the bounds below
MIN_PENDULUM_COSINE, MIN_BODY_COSINE = 0.6, 0.3  # bounds of the cosines of the tilt of pendulum and body


@inlined
def _rotated_deviation(state: Any, lane: int, field: int, reference: Any, column: int, out: Any) -> None:
    """Write the horizontal deviation of one vector, in the axes of the heading, into two fields of `out`."""
    sine, cosine = sincos(state[EULER + 2, lane])
    x, y = state[field, lane] - reference[column], state[field + 1, lane] - reference[column + 1]
    out[column, lane] = cosine * x + sine * y
    out[column + 1, lane] = cosine * y - sine * x


@inlined
def _deviation(state: Any, lanes: int, reference: Any, out: Any) -> None:
    """Write x − x_d in the axes of the heading, laid out as in `linear_model`, shape (16, lanes)."""
    for lane in range(lanes):
        _rotated_deviation(state, lane, POSITION, reference, _X_POSITION, out)
        _rotated_deviation(state, lane, VELOCITY, reference, _X_VELOCITY, out)
        _rotated_deviation(state, lane, DIRECTION, reference, _X_PENDULUM, out)
        _rotated_deviation(state, lane, DIRECTION_RATE, reference, _X_PENDULUM_RATE, out)
        out[_X_POSITION + 2, lane] = state[POSITION + 2, lane] - reference[_X_POSITION + 2]
        out[_X_VELOCITY + 2, lane] = state[VELOCITY + 2, lane] - reference[_X_VELOCITY + 2]
        for i in range(_X_ANGLES_SIZE):
            out[_X_EULER + i, lane] = state[EULER + i, lane] - reference[_X_EULER + i]


@inlined
def _add_quadratic(matrix: Any, x: Any, lanes: int, cost: Any) -> None:
    """Add ½ xᵀ matrix x to the costs, for a symmetric matrix."""
    for a in range(matrix.shape[0]):
        for b in range(a + 1):
            weight = matrix[a, b] if a > b else 0.5 * matrix[a, b]
            if weight != 0.0:
                for lane in range(lanes):
                    cost[lane] += weight * x[a, lane] * x[b, lane]


@inlined
def _unlimited_command(
    deviation: Any, gain: Any, reference: Any, samples: Any, position: float, lanes: int, command: Any, change: Any
) -> None:
    """Write the command of equation (1) of `mppi` before saturation, and its difference from u_d.

    `position` is the time as a multiple of the knot spacing.
    """
    knot = int(position)
    fraction = position - knot
    for c in range(COMMAND_SIZE):
        for lane in range(lanes):
            change[c, lane] = (1.0 - fraction) * samples[knot, c, lane] + fraction * samples[knot + 1, c, lane]
        for a in range(MODEL_STATE_SIZE):
            for lane in range(lanes):
                change[c, lane] -= gain[c, a] * deviation[a, lane]
        for lane in range(lanes):
            command[c, lane] = reference[c] + change[c, lane]


@compiled
def costs(
    state: Floats,
    disturbance: Floats,
    parameters: Floats,
    reference_state: Floats,
    reference_command: Floats,
    frame_displacement: Floats,
    samples: Floats,
    gain: Floats,
    state_weight: Floats,
    command_weight: Floats,
    terminal_weight: Floats,
    limits: Floats,
    period: float,
    substeps: int,
) -> Floats:
    """Return J of equation (2) of `mppi` for every sample, shape (n, samples).

    Args:
        state: Initial states, position and velocity relative to the reference, shape (n, 18).
        disturbance: Constant disturbance, N and N·m, shape (n, 9).
        parameters: Physical parameters of the nominal plant, shape (9,).
        reference_state: x_d, shape (H + 1, n, 16).
        reference_command: u_d, N and N·m, shape (H + 1, n, 4).
        frame_displacement: See `controllers.reference_horizon.Horizon`, shape (H, 2, n, 3).
        samples: δᵏ at the knots, N and N·m, shape (n, knots, 4, samples).
        gain: K, shape (4, 16).
        state_weight: Q, shape (16, 16).
        command_weight: R, shape (4, 4).
        terminal_weight: P, shape (16, 16).
        limits: Lowest and highest command, N and N·m, shape (2, 4).
        period: Period of the horizon, s.
        substeps: Integration steps of a period.
    """
    rows, knots, _, lanes = samples.shape
    steps = frame_displacement.shape[0]
    out = np.empty((rows, lanes))
    buffer = np.empty((_END, MAX_SAMPLES))
    lane_state, deviation = buffer[:_STATE_END], buffer[_STATE_END:_DEVIATION_END]
    command, change = buffer[_DEVIATION_END:_COMMAND_END], buffer[_COMMAND_END:_CHANGE_END]
    lane_disturbance, physics = buffer[_CHANGE_END:_DISTURBANCE_END], buffer[_DISTURBANCE_END:_PARAMETERS_END]
    cost = buffer[_PARAMETERS_END]
    for field in range(parameters.size):
        physics[field] = parameters[field]
    for row in range(rows):
        cost[:] = 0.0
        for field in range(STATE_SIZE):
            lane_state[field] = state[row, field]
        for field in range(disturbance.shape[1]):
            lane_disturbance[field] = disturbance[row, field]
        for step in range(steps):
            _deviation(lane_state, lanes, reference_state[step, row], deviation)
            position = step * (knots - 1) / steps
            _unlimited_command(
                deviation, gain, reference_command[step, row], samples[row], position, lanes, command, change
            )
            for c in range(COMMAND_SIZE):
                for lane in range(lanes):
                    command[c, lane] = min(max(command[c, lane], limits[0, c]), limits[1, c])
                    change[c, lane] = command[c, lane] - reference_command[step, row, c]
            _add_quadratic(state_weight, deviation, lanes, cost)
            _add_quadratic(command_weight, change, lanes, cost)
            integrate(lane_state, command, lane_disturbance, physics, lanes, period, substeps)
            for i in range(3):
                for lane in range(lanes):
                    lane_state[POSITION + i, lane] -= frame_displacement[step, 0, row, i]
                    lane_state[VELOCITY + i, lane] -= frame_displacement[step, 1, row, i]
            for lane in range(lanes):
                pendulum = max(MIN_PENDULUM_COSINE - lane_state[DIRECTION + 2, lane], 0.0)
                body = max(MIN_BODY_COSINE - lane_state[THRUST_AXIS + 2, lane], 0.0)
                cost[lane] += BARRIER * (pendulum * pendulum + body * body)
        _deviation(lane_state, lanes, reference_state[steps, row], deviation)
        _add_quadratic(terminal_weight, deviation, lanes, cost)
        for lane in range(lanes):
            out[row, lane] = cost[lane]
    return out
