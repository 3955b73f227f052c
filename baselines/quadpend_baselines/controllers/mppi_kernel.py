"""The futures of `mppi`, compiled: the environment's own integration, with feedback and cost around it.

The futures of one row lie side by side in the lanes of (field, lane) buffers, as in `quadpend_gym.envs.step_kernel`.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.kernel import LANE_STATE_SIZE, integrate
from quadpend_gym.physics.parameters import PARAMETERS_SIZE
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

LARGEST = 64  # number of futures of a row
# Edges of the parts of one buffer of lanes, which the compiler can tell apart.
_DEVIATION, _COMMAND, _USED, _FORCES, _PHYSICS, _COST, _END = accumulate(
    (LANE_STATE_SIZE, MODEL_STATE_SIZE, COMMAND_SIZE, COMMAND_SIZE, DISTURBANCE_SIZE, PARAMETERS_SIZE, 1)
)
BARRIER = 1e4  # cost per squared excess of a cosine
LEAST_UPRIGHT, LEAST_LEVEL = 0.6, 0.3  # cosines of the pendulum's and the body's angle where the barrier begins


@inlined
def _turn_back(state: Any, lane: int, field: int, wanted: Any, column: int, out: Any) -> None:
    """Horizontal deviation of a vector of the state, in the heading's axes, into rows `column` and + 1 of `out`."""
    sine, cosine = sincos(state[EULER + 2, lane])
    a, b = state[field, lane] - wanted[column], state[field + 1, lane] - wanted[column + 1]
    out[column, lane] = cosine * a + sine * b
    out[column + 1, lane] = cosine * b - sine * a


@inlined
def _deviate(state: Any, lanes: int, wanted: Any, out: Any) -> None:
    """x − x_d in the heading's axes, laid out as in `linear_model`, shape (16, lanes)."""
    for lane in range(lanes):
        _turn_back(state, lane, POSITION, wanted, 0, out)
        _turn_back(state, lane, VELOCITY, wanted, 3, out)
        _turn_back(state, lane, DIRECTION, wanted, 12, out)
        _turn_back(state, lane, DIRECTION_RATE, wanted, 14, out)
        out[2, lane] = state[POSITION + 2, lane] - wanted[2]
        out[5, lane] = state[VELOCITY + 2, lane] - wanted[5]
        for i in range(6):
            out[6 + i, lane] = state[EULER + i, lane] - wanted[6 + i]


@inlined
def _add_form(matrix: Any, x: Any, lanes: int, cost: Any) -> None:
    """Add ½ xᵀ matrix x, for a symmetric matrix."""
    for a in range(matrix.shape[0]):
        for b in range(a + 1):
            weight = matrix[a, b] if a > b else 0.5 * matrix[a, b]
            if weight != 0.0:
                for lane in range(lanes):
                    cost[lane] += weight * x[a, lane] * x[b, lane]


@inlined
def _ask(deviation: Any, gain: Any, wanted: Any, plans: Any, place: float, lanes: int, command: Any, used: Any) -> None:
    """Equation (1) of `mppi`, without the actuators' limits."""
    knot = int(place)
    part = place - knot
    for c in range(COMMAND_SIZE):
        for lane in range(lanes):
            used[c, lane] = (1.0 - part) * plans[knot, c, lane] + part * plans[knot + 1, c, lane]
        for a in range(MODEL_STATE_SIZE):
            for lane in range(lanes):
                used[c, lane] -= gain[c, a] * deviation[a, lane]
        for lane in range(lanes):
            command[c, lane] = wanted[c] + used[c, lane]


@compiled
def costs(
    state: Floats,
    wind: Floats,
    parameters: Floats,
    wanted: Floats,
    wanted_command: Floats,
    frame_displacement: Floats,
    plans: Floats,
    gain: Floats,
    weights: Floats,
    effort: Floats,
    terminal: Floats,
    limits: Floats,
    period: float,
    substeps: int,
) -> Floats:
    """J of equation (2) of `mppi` for every plan.

    Args:
        state: where each row is, in the reference's frame, shape (n, 18).
        wind: as `kernel.advance` takes it, shape (n, 9).
        parameters: of the plant that is believed in, shape (9,).
        wanted: x_d, shape (H + 1, n, 16).
        wanted_command: u_d, shape (H + 1, n, 4).
        frame_displacement: what to take off position and velocity after each period, shape (H, 2, n, 3).
        plans: δ at the knots, shape (n, knots, 4, samples).
        gain: K, shape (4, 16).
        weights: Q, shape (16, 16).
        effort: R, shape (4, 4).
        terminal: P, shape (16, 16).
        limits: lowest and highest command, shape (2, 4).
        period: of the horizon, s.
        substeps: in a period.

    Returns:
        Shape (n, samples).
    """
    rows, knots, _, lanes = plans.shape
    steps = frame_displacement.shape[0]
    out = np.empty((rows, lanes))
    buffer = np.empty((_END, LARGEST))
    moving, deviation, command = buffer[:_DEVIATION], buffer[_DEVIATION:_COMMAND], buffer[_COMMAND:_USED]
    used, forces, physics = buffer[_USED:_FORCES], buffer[_FORCES:_PHYSICS], buffer[_PHYSICS:_COST]
    cost = buffer[_COST]
    for field in range(parameters.size):
        physics[field] = parameters[field]
    for row in range(rows):
        cost[:] = 0.0
        for field in range(STATE_SIZE):
            moving[field] = state[row, field]
        for field in range(wind.shape[1]):
            forces[field] = wind[row, field]
        for step in range(steps):
            _deviate(moving, lanes, wanted[step, row], deviation)
            _ask(
                deviation, gain, wanted_command[step, row], plans[row], step * (knots - 1) / steps, lanes, command, used
            )
            for c in range(COMMAND_SIZE):
                for lane in range(lanes):
                    command[c, lane] = min(max(command[c, lane], limits[0, c]), limits[1, c])
                    used[c, lane] = command[c, lane] - wanted_command[step, row, c]
            _add_form(weights, deviation, lanes, cost)
            _add_form(effort, used, lanes, cost)
            integrate(moving, command, forces, physics, lanes, period, substeps)
            for i in range(3):
                for lane in range(lanes):
                    moving[POSITION + i, lane] -= frame_displacement[step, 0, row, i]
                    moving[VELOCITY + i, lane] -= frame_displacement[step, 1, row, i]
            for lane in range(lanes):
                fallen = max(LEAST_UPRIGHT - moving[DIRECTION + 2, lane], 0.0)
                tipped = max(LEAST_LEVEL - moving[STATE_SIZE + 2, lane], 0.0)
                cost[lane] += BARRIER * (fallen * fallen + tipped * tipped)
        _deviate(moving, lanes, wanted[steps, row], deviation)
        _add_form(terminal, deviation, lanes, cost)
        for lane in range(lanes):
            out[row, lane] = cost[lane]
    return out
