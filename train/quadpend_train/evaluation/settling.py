"""Settling times: how soon the error of an episode becomes small and stays small."""

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.episodes import EpisodeResults

SETTLED_ERROR = 0.05  # m
REST = 1.0  # s at the end of an episode, during which the error must be below `SETTLED_ERROR`


def settling_times(results: EpisodeResults, period: float) -> Floats:
    """Return the time after which the error stays below `SETTLED_ERROR`, s, shape (s, n).

    It is nan for an episode that has not settled: after a fall, or if the error is not below the limit during the last
    second, or during the whole of a shorter episode.

    Args:
        results: Results of s policies in n episodes.
        period: Control period, s.
    """
    outside = ~(results.error < SETTLED_ERROR)
    steps = outside.shape[-1]
    last = np.where(outside.any(axis=-1), steps - np.argmax(outside[..., ::-1], axis=-1), 0)  # steps until it stays
    settled = results.survived & (last <= max(steps - round(REST / period), 0))
    return np.where(settled, period * last, np.nan)
