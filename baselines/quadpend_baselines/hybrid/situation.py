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

from typing import Any

import numpy as np

from quadpend_baselines.estimation.estimate import INNOVATION, RIGID_PART, disturbance_of
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_gym.physics.state import DISTURBANCE_SIZE, STATE_SIZE

_TIME = 1.0  # τ, s
_INNOVATION = np.tile(np.repeat([0.01, 0.1], 3), STATE_SIZE // 6)  # scales: every second field of a state is a rate
_CHANGE = 0.1  # scale, N and N·m
SITUATION_SIZE = (STATE_SIZE + 2 * DISTURBANCE_SIZE) // 3
# Memory: m, the last estimated disturbance, and k, the number of steps of the episode so far
_STEPS = SITUATION_SIZE + DISTURBANCE_SIZE


def root(mean_square: Any) -> Any:
    """Return s of equation (2). Its slope at zero is infinite: gradients take another root there."""
    return np.sqrt(mean_square)


def _situation(numbers: tuple[float, float], seen: Seen, memory: Any) -> tuple[Any, Any]:
    period, weight = numbers
    disturbance, innovation = disturbance_of(seen.estimate, weight), seen.estimate[:, INNOVATION:RIGID_PART]
    before, last, steps = memory[:, :SITUATION_SIZE], memory[:, SITUATION_SIZE:_STEPS], memory[:, _STEPS:] + 1.0
    change = np.where(steps >= 2.0, disturbance - last, 0.0)
    squares = np.concatenate([innovation / _INNOVATION, disturbance, change / _CHANGE], axis=1) ** 2
    mean = (squares[:, ::3] + squares[:, 1::3] + squares[:, 2::3]) / 3.0
    after = before + np.maximum(1.0 / steps, period / _TIME) * (mean - before)
    return root(after), np.concatenate([after, disturbance, steps], axis=1)


def situation_part(period: float, weight: float) -> InputPart:
    """Return s; the control period is in s, and the weight of the nominal vehicle in N."""
    return InputPart(SITUATION_SIZE, _STEPS + 1, _situation, (period, weight))
