"""Intervals that stand behind every number of a comparison.

Values have the shape (s, n): s training seeds of one learner (one for a controller), each in the same n episodes. With
several seeds the bootstrap draws seeds first and then episodes, so that its interval covers both; with one it is about
that one policy only.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from quadpend_gym.arrays import Booleans, Floats

CONFIDENCE = 0.95
_RESAMPLES = 2000


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float


def proportion(successes: Booleans) -> Interval:
    """Share of successes, shape (s, n): Wilson's interval for one seed, the bootstrap's for several."""
    if len(successes) > 1:
        return mean(successes.astype(np.float64))
    low, high = stats.binomtest(int(successes.sum()), successes.size).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(float(successes.mean()), float(low), float(high))


def paired_proportion(successes: Booleans, others: Booleans) -> Interval:
    """Difference of two shares of successes in the same episodes, shapes (s, n) and (1, n) or equal.

    Agresti and Min's interval for one seed of both, the bootstrap's for several.
    """
    if len(successes) > 1 or len(others) > 1:
        return mean(successes.astype(np.float64) - others)
    gained, lost = np.sum(successes & ~others) + 0.5, np.sum(~successes & others) + 0.5
    trials = successes.size + 2
    difference = (gained - lost) / trials
    half = stats.norm.ppf((1 + CONFIDENCE) / 2) * np.sqrt(gained + lost - (gained - lost) ** 2 / trials) / trials
    return Interval(float((gained - lost) / successes.size), float(difference - half), float(difference + half))


def mean(values: Floats) -> Interval:
    """Mean, with the interval of the percentile bootstrap over seeds and episodes, shape (s, n).

    Values that are nan are left out; the mean of none is nan.
    """
    if np.isnan(values).all():
        return Interval(np.nan, np.nan, np.nan)
    random = np.random.default_rng(0)
    seeds, episodes = values.shape
    means = []
    for _ in range(_RESAMPLES):
        drawn = values[random.integers(seeds, size=seeds)][:, random.integers(episodes, size=episodes)]
        known = ~np.isnan(drawn)
        if known.any():
            means.append(drawn[known].mean())
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Interval(float(np.nanmean(values)), float(low), float(high))
