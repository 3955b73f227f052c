"""Intervals and tests that stand behind every number and every claim of a comparison.

Values have the shape (s, n): s training seeds of one learner (one for a controller), each in the same n episodes. With
several seeds the bootstrap draws seeds first and then episodes, so that its interval covers both; with one it is about
that one policy only. Values that are nan are left out.

The interquartile mean and the probability of improvement are those of Agarwal et al., "Deep Reinforcement Learning at
the Edge of the Statistical Precipice", NeurIPS 2021 (the package rliable).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import stats

from quadpend_gym.arrays import Booleans, Floats, Integers

CONFIDENCE = 0.95
_RESAMPLES = 2000
_FLIPS = 9999


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Interval":
        """The same in another unit; `factor` is positive."""
        return Interval(*(factor * x for x in self))


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
    low, high = np.clip([difference - half, difference + half], -1.0, 1.0)
    return Interval(float((gained - lost) / successes.size), float(low), float(high))


@lru_cache(maxsize=8)
def _draws(size: int, stream: int) -> Integers:
    """Indices of a bootstrap's resamples, shape (2000, size): the same for all, so that equals stay equal."""
    return np.random.default_rng([stream, size]).integers(size, size=(_RESAMPLES, size))


@lru_cache(maxsize=8)
def _weights(size: int, stream: int) -> Floats:
    """How often each index is in each resample, shape (2000, size)."""
    drawn = _draws(size, stream)
    weights = np.zeros(drawn.shape)
    np.add.at(weights, (np.arange(_RESAMPLES)[:, np.newaxis], drawn), 1.0)
    return weights


def _resampled(values: Floats) -> Floats:
    """Sum of the values in each resample of seeds and episodes, shape (2000,)."""
    seeds, episodes = values.shape
    return np.asarray(np.sum(_weights(seeds, 0) @ values * _weights(episodes, 1), axis=1))


def _between(value: float, estimates: Floats) -> Interval:
    low, high = np.quantile(estimates, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Interval(float(value), float(low), float(high))


def resampled_means(values: Floats) -> Floats:
    """Means of the bootstrap's resamples of `values`, shape (s, n) → (at most 2000,); nan if there is no value."""
    known = ~np.isnan(values)
    if known.all():
        return _resampled(values) / values.size
    counts = _resampled(known.astype(np.float64))
    if not counts.any():
        return np.array([np.nan])
    return _resampled(np.where(known, values, 0.0))[counts > 0] / counts[counts > 0]


def mean(values: Floats) -> Interval:
    """Mean, with the interval of the percentile bootstrap over seeds and episodes, shape (s, n).

    The mean of no value is nan.
    """
    known = values[~np.isnan(values)]
    return _between(known.mean() if known.size else np.nan, resampled_means(values))


def interquartile_mean(values: Floats) -> Interval:
    """Mean of the middle half of all values, shape (s, n), with the percentile bootstrap's interval; no nan.

    Outliers on either side, such as a few falls, do not move it.
    """
    seeds, episodes = values.shape
    drawn = values[_draws(seeds, 0)[:, :, np.newaxis], _draws(episodes, 1)[:, np.newaxis, :]]
    return _between(float(_trimmed(values.reshape(1, -1))[0]), _trimmed(drawn.reshape(_RESAMPLES, -1)))


def _trimmed(values: Floats) -> Floats:
    """Mean along the last axis without the lowest and highest quarter of the values, rounded down."""
    cut = int(0.25 * values.shape[-1])
    return np.asarray(np.sort(values, axis=-1)[..., cut : values.shape[-1] - cut].mean(axis=-1))


def improvement(values: Floats, others: Floats) -> Interval:
    """Probability that a value is below the other of the same episode, P(x < y) + ½ P(x = y), shapes as they pair.

    It is 0.5 for equals. This pairing is what a comparison reports: episodes differ more than policies do.
    """
    return mean(0.5 * (np.sign(others - values) + 1.0))


def improvement_unpaired(values: Floats, others: Floats) -> float:
    """The same over all pairs of a value and another, whatever their episodes: rliable's definition."""
    ranked = stats.rankdata(np.concatenate([values.ravel(), others.ravel()]))
    above = ranked[: values.size].sum() - 0.5 * values.size * (values.size + 1)  # Mann and Whitney's U
    return float(1.0 - above / (values.size * others.size))


def p_value(differences: Floats) -> float:
    """How surprising a mean difference this far from zero would be between equals, two-sided, shape (s, n).

    For one seed the randomisation test: between equals either sign of an episode's difference is as likely, so the
    mean is compared with those of 9999 random choices of signs. It assumes nothing of the distribution, and for
    survival it is McNemar's test. For several seeds, of which there are too few for that, the share of the bootstrap's
    means beyond zero, twice.
    """
    if not differences.any():
        return 1.0
    if len(differences) == 1:
        signs = _signs(differences.size)
        extreme = np.abs(signs @ differences[0]) >= abs(differences.sum()) * (1.0 - 1e-9)
        return float((extreme.sum() + 1) / (_FLIPS + 1))
    means = resampled_means(differences)
    beyond = min(np.sum(means <= 0.0), np.sum(means >= 0.0))
    return float(min(1.0, 2.0 * (beyond + 1) / (_RESAMPLES + 1)))


@lru_cache(maxsize=4)
def _signs(size: int) -> Floats:
    return np.asarray(2.0 * np.random.default_rng([2, size]).integers(2, size=(_FLIPS, size)) - 1.0)


def wilcoxon(differences: Floats) -> float:
    """p-value of Wilcoxon's signed-rank test, two-sided, on each episode's difference, mean over the seeds (s, n)."""
    paired = differences.mean(axis=0)
    return float(stats.wilcoxon(paired).pvalue) if paired.any() else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """The p-values corrected for their number (Holm), in their order: below α, the claim stands beside the others."""
    order = np.argsort(p_values, kind="stable")
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(np.arange(len(order), 0, -1) * np.take(p_values, order)))
    return [float(p) for p in corrected]
