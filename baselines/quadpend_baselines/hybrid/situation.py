"""What the last second of estimates tells about the situation: the noise of the sensors and the strength of the wind.

At each control step k of an episode, s is the running root mean square of three kinds of quantities v:

    (1)  m_k = m_{k−1} + ε_k (v̄_k² − m_{k−1}),   ε_k = max(1/k, T/τ),   τ = 1 s
    (2)  s_k = √m_k

| part of s | v                                                                        | scale     | size |
|-----------|--------------------------------------------------------------------------|-----------|------|
| residual  | measured minus estimated observation, each of its six fields (see below) | 0.1       | 6    |
| wind      | estimated force on quadrotor and bob, and torque                         | 1 N, N·m  | 3    |
| change    | its difference from the last step                                        | 0.1 N, N·m | 3   |

v̄² is the mean over the three components. The fields are those of the observation that depend on the state; fields that
are not measured have the residual zero. The residual is large where the sensors are noisy, or where the equations of
motion with nominal parameters do not predict the motion.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats, Floats32
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import (
    OBSERVATION_FIELDS,
    OBSERVATION_SIZE,
    OUTPUT_FEEDBACK_FIELDS,
    REFERENCE_START,
)

_TIME = 1.0  # τ, s
_RESIDUAL, _CHANGE = 0.1, 0.1  # scales
SITUATION_SIZE = (REFERENCE_START + 2 * DISTURBANCE_SIZE) // 3


class Situation(NamedTuple):
    """The running mean squares for n rows.

    Attributes:
        mean_square: m of equation (1), shape (n, 12).
        disturbance: The last estimated disturbance, N and N·m, shape (n, 9).
        steps: k, the number of steps of the episode so far, shape (n,).
    """

    mean_square: Floats
    disturbance: Floats
    steps: Floats


def update_situation(
    last: Situation | None,
    started: Booleans,
    observation: Floats32,
    estimated: Floats32,
    disturbance: Floats,
    period: float,
) -> Situation:
    """Return the situation after equation (1).

    Args:
        last: Situation one step ago; None at the first step.
        started: Mask of the rows whose episode begins, shape (n,).
        observation: Observation of the environment, shape (n, 36), or (n, 27) without velocities.
        estimated: Observation of the estimated state at the same time, shape (n, 36).
        disturbance: Estimated disturbance, shape (n, 9).
        period: Control period T, s.
    """
    rows = len(observation)
    if last is None:
        last = Situation(np.zeros((rows, SITUATION_SIZE)), disturbance, np.zeros(rows))
    steps = np.where(started, 1.0, last.steps + 1.0)
    change = np.where(started[:, np.newaxis], 0.0, disturbance - last.disturbance)
    parts = [_residual(observation, estimated) / _RESIDUAL, disturbance, change / _CHANGE]
    squares = (np.concatenate(parts, axis=1) ** 2).reshape(rows, SITUATION_SIZE, 3).mean(axis=2)
    share = np.maximum(1.0 / steps, period / _TIME)[:, np.newaxis]
    return Situation(last.mean_square + share * (squares - last.mean_square), disturbance, steps)


def situation_inputs(situation: Situation) -> Floats:
    """Return s of equation (2), shape (n, 12)."""
    return np.sqrt(situation.mean_square)


def _residual(observation: Floats32, estimated: Floats32) -> Floats:
    """Return the measured minus the estimated part of the observation that depends on the state, shape (n, 18)."""
    out = np.zeros((len(observation), REFERENCE_START))
    fields = OBSERVATION_FIELDS if observation.shape[1] == OBSERVATION_SIZE else OUTPUT_FEEDBACK_FIELDS
    for name, measured in fields.items():
        if (columns := OBSERVATION_FIELDS[name]).stop <= REFERENCE_START:
            out[:, columns] = observation[:, measured] - estimated[:, columns]
    return out
