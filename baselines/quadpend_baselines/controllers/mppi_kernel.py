"""The compiled rollout of `mppi`: the integration of the environment's kernel, with feedback and cost.

Each sampled trajectory of a row is one lane of the (field, lane) buffers, which `quadpend_gym.physics.euler_kernel`
describes.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from quadpend_baselines.modelling import linear_model
from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE, STATE_COLUMNS
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.euler_kernel import LANE_STATE_SIZE, THRUST_AXIS, integrate
from quadpend_gym.physics.state import (
    COMMAND_SIZE,
    DIRECTION,
    DISTURBANCE_SIZE,
    EULER,
    POSITION,
    STATE_SIZE,
    VELOCITY,
)
from quadpend_gym.vehicles.parameters import PARAMETERS_SIZE

MAX_SAMPLES = 64  # sampled trajectories of a row
# Ends of the parts of one buffer. For parts of one buffer, the compiler can prove that they do not overlap.
_STATE_END, _DEVIATION_END, _COMMAND_END, _CHANGE_END, _DISTURBANCE_END, _PARAMETERS_END, _END = accumulate(
    (LANE_STATE_SIZE, MODEL_STATE_SIZE, COMMAND_SIZE, COMMAND_SIZE, DISTURBANCE_SIZE, PARAMETERS_SIZE, 1)
)
# First columns of the vectors in x of `linear_model` that turn with the heading.
_TURNED = tuple(
    part.start
    for part in (linear_model.POSITION, linear_model.VELOCITY, linear_model.PENDULUM, linear_model.PENDULUM_RATE)
)
BARRIER = 1e4  # cost per squared violation of the bounds below
MIN_PENDULUM_COSINE, MIN_BODY_COSINE = 0.6, 0.3  # bounds of the cosines of the tilt of pendulum and body


@inlined
def _deviation(state: Any, lanes: int, reference: Any, out: Any) -> None:
    """Write x − x_d in the axes of the heading, laid out as in `linear_model`, shape (16, lanes)."""
    for field in range(MODEL_STATE_SIZE):
        for lane in range(lanes):
            out[field, lane] = state[STATE_COLUMNS[field], lane] - reference[field]
    for lane in range(lanes):
        sine, cosine = sincos(state[EULER + 2, lane])
        for field in _TURNED:
            x, y = out[field, lane], out[field + 1, lane]
            out[field, lane] = cosine * x + sine * y
            out[field + 1, lane] = cosine * y - sine * x


@inlined
def _add_quadratic(matrix: Any, x: Any, lanes: int, cost: Any) -> None:
    """Add ½ xᵀ matrix x to the costs, for a symmetric matrix."""
    for a in range(matrix.shape[0]):
        for b in range(a + 1):
            weight = matrix[a, b] if a > b else 0.5 * matrix[a, b]
            if weight != 0.0:
                for lane in range(lanes):
                    cost[lane] += weight * x[a, lane] * x[b, lane]


@compiled
def costs(
    state: Floats,  # initial states, position and velocity relative to the reference, shape (n, 18)
    disturbance: Floats,  # constant disturbance, N and N·m, shape (n, 9)
    parameters: Floats,  # physical parameters of the nominal plant, shape (9,)
    reference_state: Floats,  # x_d, shape (H + 1, n, 16)
    reference_command: Floats,  # u_d, N and N·m, shape (H + 1, n, 4)
    frame_displacement: Floats,  # see `controllers.reference_horizon.Horizon`, shape (H, 2, n, 3)
    samples: Floats,  # δᵏ at the knots, N and N·m, shape (n, knots, 4, samples)
    gain: Floats,  # K, shape (4, 16)
    state_weight: Floats,  # Q, shape (16, 16)
    command_weight: Floats,  # R, shape (4, 4)
    terminal_weight: Floats,  # P, shape (16, 16)
    limits: Floats,  # lowest and highest command, N and N·m, shape (2, 4)
    period: float,  # of the horizon, s
    substeps: int,  # integration steps of a period
) -> Floats:
    """Return J of equation (2) of `mppi` for every sample, shape (n, samples)."""
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
            position = step * (knots - 1) / steps  # time as a multiple of the knot spacing
            knot = int(position)
            share = position - knot
            for c in range(COMMAND_SIZE):
                nominal = reference_command[step, row, c]
                for lane in range(lanes):
                    change[c, lane] = (1.0 - share) * samples[row, knot, c, lane] + share * samples[
                        row, knot + 1, c, lane
                    ]
                for a in range(MODEL_STATE_SIZE):
                    for lane in range(lanes):
                        change[c, lane] -= gain[c, a] * deviation[a, lane]
                for lane in range(lanes):
                    command[c, lane] = min(max(nominal + change[c, lane], limits[0, c]), limits[1, c])
                    change[c, lane] = command[c, lane] - nominal
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
        out[row] = cost[:lanes]
    return out
