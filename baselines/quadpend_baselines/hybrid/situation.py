"""What the last second tells about the situation: how well the observer predicts, and how strong the disturbance is.

At each control step k of an episode, s is the running root mean square of three kinds of quantities v:

    (1)  m_k = m_{k−1} + ε_k (v̄_k² − m_{k−1}),   ε_k = max(1/k, T/τ),   τ = 1 s
    (2)  s_k = √m_k

| part of s   | v                                                               | scale                        | size |
|-------------|-----------------------------------------------------------------|------------------------------|------|
| innovation  | measured minus predicted state, each of the fields of `State`   | 0.01 m, 0.1 m/s, 0.01 rad, … | 6    |
| disturbance | estimated force on quadrotor and bob, and torque                | 1 N, 1 N, 1 N·m              | 3    |
| change      | its difference from the last step                               | 0.1 N, 0.1 N, 0.1 N·m        | 3    |

v̄² is the mean over the three components. Rates have ten times the scale of the fields that they belong to. The
innovation is that of the Kalman observer before its correction. It is large where the sensors are noisy, or where the
equations of motion with nominal parameters do not predict the motion; that of rates that are not measured is zero. The
estimated disturbance is the wind and all that the observer takes for it, such as a wrong mass.
"""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE

_TIME = 1.0  # τ, s
_INNOVATION = np.tile(np.repeat([0.01, 0.1], 3), STATE_SIZE // 6)  # scales: every second field of a state is a rate
_CHANGE = 0.1  # scale, N and N·m
SITUATION_SIZE = (STATE_SIZE + 2 * DISTURBANCE_SIZE) // 3


class Situation(NamedTuple):
    """The running mean squares for n rows."""

    mean_square: Floats  # m of equation (1), shape (n, 12)
    disturbance: Floats  # the last estimated disturbance, N and N·m, shape (n, 9)
    steps: Floats  # k, the number of steps of the episode so far, shape (n,)


def update_situation(
    last: Situation | None, started: Booleans, innovation: Floats, disturbance: Floats, period: float
) -> Situation:
    """Return the situation after equation (1), T = `period`, from the one a step ago (None at the first step).

    Innovation and disturbance have the shapes (n, 18) and (n, 9); `started` is the mask of the rows that begin, (n,).
    """
    rows = len(innovation)
    if last is None:
        last = Situation(np.zeros((rows, SITUATION_SIZE)), disturbance, np.zeros(rows))
    steps = np.where(started, 1.0, last.steps + 1.0)
    change = np.where(started[:, np.newaxis], 0.0, disturbance - last.disturbance)
    share = new_share(steps, period)[:, np.newaxis]
    added = share * (mean_squares(innovation, disturbance, change) - last.mean_square)
    return Situation(last.mean_square + added, disturbance, steps)


def mean_squares(innovation: Floats, disturbance: Floats, change: Floats) -> Floats:
    """Return v̄² of equation (1), shape (n, 12)."""
    parts = [innovation / _INNOVATION, disturbance, change / _CHANGE]
    squares: Floats = np.concatenate(parts, axis=1) ** 2
    return np.asarray((squares[:, ::3] + squares[:, 1::3] + squares[:, 2::3]) / 3.0)


def new_share(steps: Floats, period: float) -> Floats:
    """Return ε of equation (1) in step k of an episode, shape (n,)."""
    return np.maximum(1.0 / steps, period / _TIME)


def situation_inputs(situation: Situation) -> Floats:
    """Return s of equation (2), shape (n, 12)."""
    return np.sqrt(situation.mean_square)
