"""Inputs of a policy without parameters of its vehicle: the measurements, and a memory of them.

The memory is a set of first-order filters of the measured values m and the last action. With x = (m, a_{k−1}),

    (1)  f_k = f_{k−1} + (1 − e^{−T/τ}) (x_k − f_{k−1}),     τ = 0.02, 0.06, 0.2, 0.6 and 2 s;   f = x at the start

x − f is about τ ẋ where x changes slowly. From it a network can infer velocities, the response to its actions, mean
wind and biases.

| part                                                                                | size | scale              |
|-------------------------------------------------------------------------------------|------|--------------------|
| m: tracking error (m), r_x r_y, and φ θ ψ_e (rad)                                   | 8    | 0.05 m, 0.05, 0.25 |
| the last action                                                                     | 4    | 0.2                |
| the derivatives of order 2 to 6 of the reference; ψ̇_d and ψ̈_d                       | 17   | their own          |
| x − f for each τ                                                                    | 60   | as m and action    |

Horizontal vectors are in the axes of the heading.
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.observation import read_observation

_TIMES = 0.02, 0.06, 0.2, 0.6, 2.0  # τ, s
_SCALE = np.array([0.05] * 5 + [0.25] * 3 + [0.2] * ACTION_SIZE)
_REFERENCE = tuple(f"reference_{order}" for order in range(2, 7))
_SIZE = _SCALE.size  # of x
REMEMBERED_SIZE = _SIZE * len(_TIMES)
MEMORY_SIZE = _SIZE + 3 * len(_REFERENCE) + 2 + REMEMBERED_SIZE


def memory_inputs(
    observation: Floats32, action: Floats32, remembered: Floats | None, started: Booleans, period: float
) -> tuple[Floats, Floats]:
    """Return the inputs, shape (n, 89), and f, shape (n, 60).

    Args:
        observation: Of the environment, shape (n, 36) or (n, 27).
        action: The last action, shape (n, 4); zeros in rows that begin.
        remembered: f of the last step; None at the first step.
        started: Mask of the rows whose episode begins, shape (n,).
        period: T, the control period, s.
    """
    attitude = read_observation(observation, "attitude")
    yaw, *yaw_rates = read_observation(observation, "yaw_reference").T
    angle = attitude[:, 2] + yaw
    sine, cosine = np.sin(angle), np.cos(angle)

    def turned(name: str) -> Floats:
        x, y, z = read_observation(observation, name).T
        return np.column_stack([cosine * x + sine * y, cosine * y - sine * x, z])

    seen: list[Any] = [turned("tracking_error"), turned("direction")[:, :2], attitude, action]
    x = np.column_stack(seen) / _SCALE
    inputs = np.tile(x, len(_TIMES))  # of the filters
    last = inputs if remembered is None else np.where(started[:, np.newaxis], inputs, remembered)
    shares = np.repeat(1.0 - np.exp(-period / np.array(_TIMES)), _SIZE)
    now = last + shares * (inputs - last)
    reference = [turned(name) for name in _REFERENCE]
    return np.column_stack([x, *reference, *yaw_rates, inputs - now]), now
