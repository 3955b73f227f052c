"""Intervals and tests that stand behind every number and every claim of a comparison.

Values have the shape (s, n): s training seeds of one learner (one for a controller), each in the same n episodes.
Values that are nan are left out.

With one seed, what is said is about that one policy, over all episodes there could be: intervals of means are those of
the percentile bootstrap over episodes, tests are by randomisation. With several seeds it is about the learner, over all
seeds and all episodes there could be. Both count as drawn at random (two-way random effects):

    m = mean of the seeds' means,   V_s = var(seeds' means) / s,   V_e = var(episodes' means) / n,
    interval: m ± √(t²_{s−1} V_s + t²_{n−1} V_e),                                                       (1)

where t_k is the quantile of Student's distribution with k degrees of freedom and var the unbiased estimate. (1) never
covers less than it says if effects and residual are normal and no value is nan (Banerjee, "Approximate confidence
interval for linear functions of means of k populations when the population variances are not equal", Sankhyā 1960).
V_s + V_e counts the residual twice, which errs on the safe side. Satterthwaite's degrees of freedom for V_s + V_e would
make it narrower, but cover 87 % to 90 % with two seeds. The p-value is the level at which (1) reaches zero.

The interquartile mean and the probability of improvement are those of Agarwal et al., "Deep Reinforcement Learning at
the Edge of the Statistical Precipice", NeurIPS 2021 (the package rliable).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import optimize, special, stats

from quadpend_gym.core.arrays import Booleans, Floats, Integers

CONFIDENCE = 0.95
_RESAMPLES = 2000
_FLIPS = 9999
_LEAST = 1e-12  # the smallest p-value that is told apart from zero
_TAIL = 0.25 / stats.norm.sf(np.sqrt(2.0))  # 3.178, of Bentkus and Dzindzalieta's bound


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Interval":
        """The same in another unit; `factor` is positive."""
        return Interval(*(factor * x for x in self))

    def clipped(self, low: float, high: float) -> "Interval":
        """The same with ends that are possible."""
        return Interval(self.value, *(float(np.clip(x, low, high)) for x in self[1:]))

    def widened(self, other: "Interval") -> "Interval":
        """The same estimate with the ends of either interval that lie farther out."""
        return Interval(self.value, min(self.low, other.low), max(self.high, other.high))


def proportion(successes: Booleans) -> Interval:
    """Share of successes, shape (s, n): Wilson's interval, for several seeds of all n s episodes and widened to (1).

    So it is never certain, not even if every episode was a success.
    """
    low, high = stats.binomtest(int(successes.sum()), successes.size).proportion_ci(CONFIDENCE, method="wilson")
    pooled = Interval(float(successes.mean()), float(low), float(high))
    return _over_seeds(pooled, successes.astype(np.float64), 0.0)


def paired_proportion(successes: Booleans, others: Booleans) -> Interval:
    """Difference of two shares of successes in the same episodes, shapes (s, n) and (1, n) or equal.

    Agresti and Min's interval, for several seeds of all n s pairs and widened to (1), see `p_proportion`.
    """
    gained, lost = np.sum(successes & ~others) + 0.5, np.sum(~successes & others) + 0.5
    differences = successes.astype(np.float64) - others
    trials = differences.size + 2
    difference = (gained - lost) / trials
    half = stats.norm.ppf((1 + CONFIDENCE) / 2) * np.sqrt(gained + lost - (gained - lost) ** 2 / trials) / trials
    pooled = Interval(float(differences.mean()), float(difference - half), float(difference + half)).clipped(-1.0, 1.0)
    return _over_seeds(pooled, _cautious(differences), -1.0)


def _cautious(differences: Floats) -> Floats:
    """Differences of successes with an episode that was gained and one that was lost, shape (s, n) → (s, n + 2)."""
    return np.hstack([differences, np.tile([1.0, -1.0], (len(differences), 1))])


def _over_seeds(pooled: Interval, values: Floats, least: float) -> Interval:
    """The interval of pooled episodes, for several seeds widened to theirs; values are from `least` to 1."""
    return pooled if len(values) == 1 else pooled.widened(mean(values).clipped(least, 1.0))


@lru_cache(maxsize=8)
def _draws(size: int, stream: int) -> Integers:
    """Indices of a bootstrap's resamples, shape (2000, size): the same for all, so that equals stay equal."""
    return np.random.default_rng([stream, size]).integers(size, size=(_RESAMPLES, size))


@lru_cache(maxsize=8)
def _weights(size: int) -> Floats:
    """How often each episode is in each resample, shape (2000, size)."""
    drawn = _draws(size, 1)
    weights = np.zeros(drawn.shape)
    np.add.at(weights, (np.arange(_RESAMPLES)[:, np.newaxis], drawn), 1.0)
    return weights


def _between(value: float, estimates: Floats) -> Interval:
    low, high = np.quantile(estimates, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Interval(float(value), float(low), float(high))


def _resampled_means(values: Floats) -> Floats:
    """Means of the bootstrap's resamples of some values that are not all nan, shape (n,) → (at most 2000,)."""
    known = ~np.isnan(values)
    counts = _weights(values.size) @ known
    return np.asarray((_weights(values.size) @ np.where(known, values, 0.0))[counts > 0] / counts[counts > 0])


def mean(values: Floats) -> Interval:
    """Mean, shape (s, n), with the percentile bootstrap's interval for one seed and that of (1) for several.

    Every seed with a value weighs the same. If only one of several has any, what is said is about that one; the mean of
    no value is nan. The bootstrap knows only what it has seen: something that happens less often than about once in n/3
    episodes may not be among them, and then its interval, of however large an effect, leaves it out.
    """
    seen = values[~np.isnan(values).all(axis=1)]
    if not seen.size:
        return Interval(np.nan, np.nan, np.nan)
    if len(seen) == 1:
        return _between(float(np.nanmean(seen)), _resampled_means(seen[0]))
    effects = _effects(seen)
    half = effects.half_width(1.0 - CONFIDENCE)
    return Interval(effects.mean, effects.mean - half, effects.mean + half)


class _Effects(NamedTuple):
    """What (1) needs: m, and of seeds and episodes each the squared standard error and the degrees of freedom."""

    mean: float
    variances: Floats
    freedoms: Floats

    def half_width(self, level: float) -> float:
        """Of the interval that misses the truth with a chance of at most `level`."""
        return float(np.sqrt(np.sum(special.stdtrit(self.freedoms, 0.5 * level) ** 2 * self.variances)))


def _effects(values: Floats) -> _Effects:
    """Of at least two seeds, each with a value; an effect that was seen but once, as of one episode, is left out."""
    seeds = np.nanmean(values, axis=1)
    episodes = np.nanmean(values[:, ~np.isnan(values).all(axis=0)], axis=0)
    means = [x for x in (seeds, episodes) if x.size > 1]
    variances = np.array([x.var(ddof=1) / x.size for x in means])
    return _Effects(float(seeds.mean()), variances, np.array([x.size - 1.0 for x in means]))


def interquartile_mean(values: Floats) -> Interval:
    """Mean of the middle half of all values, shape (s, n), with the percentile bootstrap's interval; no nan.

    Outliers on either side, such as a few falls, do not move it. For several seeds the bootstrap is rliable's, of seeds
    and of episodes, and its interval is too narrow if seeds are few: with five, it covers 85 % or so.
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
    return mean(0.5 * (np.sign(others - values) + 1.0)).clipped(0.0, 1.0)


def improvement_unpaired(values: Floats, others: Floats) -> float:
    """The same over all pairs of a value and another, whatever their episodes: rliable's definition."""
    ranked = stats.rankdata(np.concatenate([values.ravel(), others.ravel()]))
    above = ranked[: values.size].sum() - 0.5 * values.size * (values.size + 1)  # Mann and Whitney's U
    return float(1.0 - above / (values.size * others.size))


def p_value(differences: Floats) -> float:
    """How surprising a mean difference this far from zero would be between equals, two-sided, shape (s, n).

    For several seeds the level at which the interval (1) of the mean reaches zero; 1 if fewer than two have a value. It
    is right or too large if seeds are normal. If they are as skewed as the exponential distribution, 9 % to 12 % of
    equals are told apart at the 5 % level.

    For one seed the randomisation test. Its null hypothesis is that the two are exchangeable within each episode: an
    episode's difference has either sign as likely. The mean is compared with those of 9999 random choices of signs.
    That is valid for any number of episodes and however heavy the tails. If only the mean is zero and the differences
    are skewed, it is valid as n grows: at the 5 % level it rejects 5 % (exponential) and 7 % (lognormal, σ = 1) at
    n = 200, 9 % and 15 % at n = 10; the t test does the same, but Wilcoxon's, which is about ranks, 62 % and 97 % at
    n = 200.

    If none of the choices is as extreme, p is, where that is smaller, a bound on the share of all 2ⁿ choices that are:
    3.178 times the normal distribution's tails (Bentkus and Dzindzalieta, "A tight Gaussian bound for weighted sums of
    Rademacher random variables", Bernoulli 2015). So p can be small enough for a correction for many tests.
    """
    seen = differences[~np.isnan(differences).all(axis=1)]
    if len(differences) > 1:
        return _p_over_seeds(_effects(seen)) if len(seen) > 1 else 1.0
    values = np.nan_to_num(differences[0])
    if not values.any():
        return 1.0
    extreme = np.sum(np.abs(_signs(values.size) @ values) >= abs(values.sum()) * (1.0 - 1e-9))
    tails = 2.0 * _TAIL * stats.norm.sf(abs(values.sum()) / np.linalg.norm(values))
    return float((extreme + 1) / (_FLIPS + 1) if extreme else min(1.0 / (_FLIPS + 1), tails))


@lru_cache(maxsize=4)
def _signs(size: int) -> Floats:
    return np.asarray(2.0 * np.random.default_rng([2, size]).integers(2, size=(_FLIPS, size)) - 1.0)


def _p_over_seeds(effects: _Effects) -> float:
    distance = abs(effects.mean)
    if not distance or effects.half_width(_LEAST) <= distance:
        return _LEAST if distance else 1.0
    log = optimize.brentq(lambda log: effects.half_width(np.exp(log)) - distance, np.log(_LEAST), 0.0)
    return float(np.exp(log))


def p_proportion(successes: Booleans, others: Booleans) -> float:
    """The same for two shares of successes in the same episodes, shapes (s, n) and (1, n) or equal.

    For one seed of both the randomisation test over all choices of signs, which is McNemar's exact test. For several,
    one more episode is added that all seeds gain, and one that all lose: where failures are rare, a controller may have
    had none in its n episodes by chance, which s seeds would only seem to confirm.
    """
    if len(successes) > 1 or len(others) > 1:
        return p_value(_cautious(successes.astype(np.float64) - others))
    gained, lost = int(np.sum(successes & ~others)), int(np.sum(~successes & others))
    return float(min(1.0, 2.0 * stats.binom.cdf(min(gained, lost), gained + lost, 0.5)))


def wilcoxon(differences: Floats) -> float:
    """p-value of Wilcoxon's signed-rank test, two-sided, on each episode's difference, mean over the seeds (s, n).

    It is about the ranks, not the mean, and about these seeds, not all there could be.
    """
    paired = differences.mean(axis=0)
    return float(stats.wilcoxon(paired).pvalue) if paired.any() else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """The p-values corrected for their number (Holm), in their order: below α, the claim stands beside the others."""
    order = np.argsort(p_values, kind="stable")
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(np.arange(len(order), 0, -1) * np.take(p_values, order)))
    return [float(p) for p in corrected]
