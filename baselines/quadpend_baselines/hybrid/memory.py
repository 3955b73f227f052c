"""Inputs of a policy without parameters of its vehicle: the measurements, and a memory of them.

The memory begins with first-order filters of the measured values m and the last action. With x = (m, a_{k−1}),

    (1)  f_k = f_{k−1} + (1 − e^{−T/τ}) (x_k − f_{k−1}),     τ = 0.02, 0.06, 0.2, 0.6 and 2 s;   f = x at the start

x − f is about τ ẋ where x changes slowly. From it a network can infer velocities, the response to its actions, mean
wind and biases. Two neighbouring filters give a rate of roll and pitch, and the actions filtered alike,

    (2)  y = (f − f⁺)/(τ⁺ − τ) of φ and θ,     u = (τ f − τ⁺ f⁺)/(τ − τ⁺) of their actions      +: the next τ

and recursive least squares with a forgetting factor and a prior p of the weight w, over both axes,

    (3)  b = (Σ λᵏ u y + w p)/(Σ λᵏ u² + w),     p = 7.5 rad/s,     λ = e^{−T/10 s}

estimates the body rate that an action of 1 commands. With quicker filters the lag of the vehicle lowers it.

| part                                                                                | size | scale              |
|-------------------------------------------------------------------------------------|------|--------------------|
| m: tracking error (m), r_x r_y, and φ θ ψ_e (rad)                                   | 8    | 0.05 m, 0.05, 0.25 |
| the last action                                                                     | 4    | 0.2                |
| the derivatives of order 2 to 6 of the reference; ψ̇_d and ψ̈_d                       | 17   | their own          |
| x − f for each τ                                                                    | 60   | as m and action    |
| b − p for the first three τ                                                         | 3    | 3.75 rad/s         |

Horizontal vectors are in the axes of the heading.
"""

from typing import Any

import numpy as np

from quadpend_baselines.hybrid.innovations import filter_shares
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import select, sincos
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.observation import (
    OBSERVATION_SCALE,
    OUTPUT_FEEDBACK,
    OUTPUT_FEEDBACK_COLUMNS,
    OUTPUT_FEEDBACK_FIELDS,
    ObservationLayout,
)

_TIMES = 0.02, 0.06, 0.2, 0.6, 2.0  # τ, s
_MEMORY = 10.0  # s, of the least squares
_PRIOR, _WEIGHT = 6.0, 0.5  # p and w of (3), in the scales of φ and the actions
_STEP = 0.01  # s: period of which w is a multiple
_SCALE = np.array([0.05] * 5 + [0.25] * 3 + [0.2] * ACTION_SIZE)
_UNITS = OBSERVATION_SCALE[OUTPUT_FEEDBACK_COLUMNS]
_ATTITUDE, _REFERENCE, _YAW = (
    OUTPUT_FEEDBACK_FIELDS[name].start for name in ("attitude", "reference_2", "yaw_reference")
)
_SIZE, _ROLL, _ROLL_ACTION = len(_SCALE), 5, 9  # of x, and places in it
_ORDERS = (_YAW - _REFERENCE) // 3
_FILTERED = _SIZE * len(_TIMES)
_ESTIMATES = 3
# Memory: f, the sums of the least squares, and 1 after the first step of an episode
_BEGUN = _FILTERED + 2 * _ESTIMATES
REMEMBERED_SIZE = _BEGUN + 1
MEMORY_SIZE: int = _SIZE + 3 * _ORDERS + 2 + _FILTERED + _ESTIMATES


@compiled
def _inputs(
    seen: Floats,
    action: Floats,
    last: Floats,
    shares: Floats,
    forgetting: float,
    step: float,
    out: Floats,
    now: Floats,
) -> None:
    for row in range(out.shape[0]):
        sine, cosine = sincos(_UNITS[_ATTITUDE + 2] * seen[row, _ATTITUDE + 2] + _UNITS[_YAW] * seen[row, _YAW])
        for k in range(2 + _ORDERS):  # tracking error, direction and the reference's derivatives
            first = 3 * k if k < 2 else _REFERENCE + 3 * (k - 2)
            place = first if k < 2 else _SIZE + 3 * (k - 2)
            x, y = _UNITS[first] * seen[row, first], _UNITS[first + 1] * seen[row, first + 1]
            out[row, place], out[row, place + 1] = cosine * x + sine * y, cosine * y - sine * x
            if k != 1:
                out[row, place + 2] = _UNITS[first + 2] * seen[row, first + 2]
        for i in range(3):
            out[row, _ROLL + i] = _UNITS[_ATTITUDE + i] * seen[row, _ATTITUDE + i]
        for i in range(ACTION_SIZE):
            out[row, _SIZE - ACTION_SIZE + i] = action[row, i]
        for i in range(_SIZE):
            out[row, i] /= _SCALE[i]
        for i in range(2):
            out[row, _SIZE + 3 * _ORDERS + i] = _UNITS[_YAW + 1 + i] * seen[row, _YAW + 1 + i]
        first, is_new = _SIZE + 3 * _ORDERS + 2, last[row, _BEGUN] < 1.0
        now[row, _BEGUN] = 1.0
        for j in range(len(_TIMES)):
            for i in range(_SIZE):
                before = select(is_new, out[row, i], last[row, j * _SIZE + i])
                now[row, j * _SIZE + i] = before + shares[j] * (out[row, i] - before)
                out[row, first + j * _SIZE + i] = out[row, i] - now[row, j * _SIZE + i]
        for j in range(_ESTIMATES):
            place, a, b = _FILTERED + 2 * j, j * _SIZE, (j + 1) * _SIZE
            span = _TIMES[j + 1] - _TIMES[j]
            products = squares = 0.0
            for i in range(2):
                rate = (now[row, a + _ROLL + i] - now[row, b + _ROLL + i]) / span
                command = _TIMES[j + 1] * now[row, b + _ROLL_ACTION + i] - _TIMES[j] * now[row, a + _ROLL_ACTION + i]
                products += rate * command / span
                squares += (command / span) ** 2
            now[row, place] = step * products + forgetting * last[row, place]
            now[row, place + 1] = step * squares + forgetting * last[row, place + 1]
            slope = (now[row, place] + _WEIGHT * _PRIOR) / (now[row, place + 1] + _WEIGHT)
            out[row, first + _FILTERED + j] = (slope - _PRIOR) / (0.5 * _PRIOR)


def _memory(numbers: tuple[float, ObservationLayout], seen: Seen, memory: Any) -> tuple[Any, Any]:
    period, layout = numbers
    layout.check(seen.observation)
    observed = seen.observation[:, layout.select(OUTPUT_FEEDBACK)].astype(np.float64)
    action = seen.action.astype(np.float64)
    out, now = np.empty((len(observed), MEMORY_SIZE)), np.empty((len(observed), REMEMBERED_SIZE))
    forgetting = float(np.exp(-period / _MEMORY))
    _inputs(observed, action, memory, filter_shares(period, _TIMES), forgetting, period / _STEP, out, now)
    return out, now


def memory_part(period: float, layout: ObservationLayout) -> InputPart:
    """Return the inputs of the table, for observations with the fields of a layout; the control period is in s."""
    return InputPart(MEMORY_SIZE, REMEMBERED_SIZE, _memory, (period, layout))
