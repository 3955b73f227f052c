"""Settling times of episodes."""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats

SETTLED_ERROR = 0.05  # m
REST = 1.0  # s at the end of an episode, during which the error must be below the limit


def settling_times(survived: Booleans, error: Any, period: float, limit: float = SETTLED_ERROR) -> Floats:
    """Return the time after which the error stays below `limit`, s, shape (s, n).

    It is nan for an episode that has not settled: after a fall, or if the error is not below the limit during the last
    second, or during the whole of a shorter episode. The error after each step has the shape (s, n, T), in m.
    """
    outside = ~(error < limit)
    steps = outside.shape[-1]
    last = np.where(outside.any(axis=-1), steps - np.argmax(outside[..., ::-1], axis=-1), 0)  # steps until it stays
    settled = survived & (last <= max(steps - round(REST / period), 0))
    return np.where(settled, period * last, np.nan)
