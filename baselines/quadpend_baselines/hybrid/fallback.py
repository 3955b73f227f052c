"""Reduce the policy's action when the base controller's observer reports an anomaly.

With a fallback gain γ > 0 the hybrid uses c a instead of the policy's action a. The weight c decreases with the torque
that the observer estimates and with the tilt of the pendulum. The torque indicates delayed or slow actuators: the
observer attributes their effect to a torque, and the wind models exert almost none. The anomaly score q decays with a
time constant of 1 s; the policy does not observe it. In control step k of the period T

    (4)  c_k = 1/(1 + γ² q_k²),    q_k = max(|τ̂_k|/(0.5 N·m), |r_xy|/0.2, 0.99^(T/10 ms) q_{k−1}).

| symbol | code name       | unit | frame        | shape  |
|--------|-----------------|------|--------------|--------|
| γ      | `fallback_gain` | 1    | –            | scalar |
| c      | `weight`        | 1    | –            | (n,)   |
| q      | `anomaly_score` | 1    | –            | (n,)   |
| τ̂      | `torque`        | N·m  | φ, θ, ψ axes | (n, 3) |
| r      | `direction`     | 1    | world        | (n, 3) |
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.physics.state import Disturbance
from quadpend_gym.tasks.observation import read_observation
from quadpend_gym.vehicles import CONTROL_PERIOD

_TORQUE, _TILT, _DECAY = 0.5, 0.2, 0.99  # N·m, 1, per 10 ms


def update_anomaly_score(
    fallback_gain: float,
    observation: Floats32,
    disturbance: Floats,
    last_score: Floats | None,
    episode_start: Any,
    period: float,
) -> Floats:
    """Return q_k of equation (4), shape (n,); zeros if the fallback gain is zero.

    Args:
        fallback_gain: γ.
        observation: Estimated observation, shape (n, 36) or (n, 27).
        disturbance: Estimated disturbance, shape (n, 9).
        last_score: q_{k−1}; None at the first step.
        episode_start: Mask of the rows whose episode begins, shape (n,).
        period: T, s.
    """
    if not fallback_gain:
        return np.zeros(len(observation))
    tilt = np.linalg.norm(read_observation(observation, "direction")[:, :2], axis=1) / _TILT
    score = np.maximum(np.linalg.norm(Disturbance(disturbance).torque, axis=1) / _TORQUE, tilt)
    if last_score is not None:
        decay = _DECAY ** (period / CONTROL_PERIOD)
        score = np.where(episode_start, score, np.maximum(score, decay * last_score))
    return np.asarray(score)


def weigh_action(fallback_gain: float, action: Floats32, anomaly_score: Floats) -> Floats32:
    """Return c a of equation (4), shape (n, 4); the action itself if the fallback gain is zero."""
    if not fallback_gain:
        return action
    weight = 1.0 / (1.0 + (fallback_gain * anomaly_score) ** 2)
    return np.asarray((weight[:, np.newaxis] * action).astype(np.float32))
