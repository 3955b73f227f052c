"""Intervals that stand behind every number of a comparison."""

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
    """Share of successes, with Wilson's interval; `successes` has shape (n,)."""
    found = stats.binomtest(int(successes.sum()), successes.size)
    low, high = found.proportion_ci(CONFIDENCE, method="wilson")
    return Interval(float(successes.mean()), float(low), float(high))


def paired_proportion(successes: Booleans, others: Booleans) -> Interval:
    """Difference of two shares of successes in the same n trials, with Agresti and Min's interval, each shape (n,)."""
    gained, lost = np.sum(successes & ~others) + 0.5, np.sum(~successes & others) + 0.5
    trials = successes.size + 2
    difference = (gained - lost) / trials
    half = stats.norm.ppf((1 + CONFIDENCE) / 2) * np.sqrt(gained + lost - (gained - lost) ** 2 / trials) / trials
    return Interval(float((gained - lost) / successes.size), float(difference - half), float(difference + half))


def mean(values: Floats) -> Interval:
    """Mean of n values, with the percentile bootstrap's interval; nan where there are none."""
    if values.size == 0:
        return Interval(np.nan, np.nan, np.nan)
    random = np.random.default_rng(0)
    means = random.choice(values, (_RESAMPLES, values.size)).mean(axis=1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Interval(float(values.mean()), float(low), float(high))
