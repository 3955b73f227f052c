"""Recovery: whether and when an episode comes back to its reference and stays there."""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.statistics import Interval, mean, proportion

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


def recovery(results: EpisodeResults, period: float, limit: float = 0.1) -> tuple[Interval, Interval]:
    """Return the share of episodes that settle, %, and the mean of their settling times, s."""
    times = settling_times(results.survived, results.error, period, limit)
    return proportion(~np.isnan(times)).scaled(100.0), mean(times)
