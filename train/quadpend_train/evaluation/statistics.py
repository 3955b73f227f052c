"""Confidence intervals and hypothesis tests for comparisons of policies.

Values have the shape (s, n): s training seeds of one learner (s = 1 for a controller), each evaluated in the same n
episodes. Values that are nan are left out. Successes may have the shape (s, c, n): episode k of all c scenarios has the
same seed, so wind and noise of its c flights are alike, and its successes may be correlated. Their number is then
divided by the design effect

    D = max( 1, c · var(episodes' means) / var(flights) )                                                (4)

of clusters that are the episodes (Kish 1965; Korn and Graubard, "Confidence intervals for proportions with small
expected number of positive counts estimated from survey data", Survey Methodology 1998). Without a failure D is 1.

With one seed the statements are about that one policy, over the population of episodes: intervals of means are
Student's, corrected for the skewness of the values (2), tests are randomisation tests. With several seeds the
statements are about the learner, over the populations of training seeds and of episodes, both as random effects
(two-way random effects):

    m = mean of the seeds' means,   V_s = var(seeds' means) / s,   V_e = var(episodes' means) / n,
    interval: m ± √(t²_{s−1} V_s + t²_{n−1} V_e),                                                       (1)

where t_k is the quantile of Student's distribution with k degrees of freedom and var the unbiased estimate. The
coverage of (1) is at least the nominal one if effects and residual are normal and no value is nan (Banerjee,
"Approximate confidence interval for linear functions of means of k populations when the population variances are not
equal", Sankhyā 1960). V_s + V_e counts the residual twice, which makes the interval conservative. The p-value is the
level at which (1) reaches zero.

For one seed with the mean m, the standard deviation σ (unbiased variance), the skewness γ and a = γ / √n:

    T = √n (m − μ) / σ is skewed; g(T) = T + a T²/3 + a² T³/27 + a/6 is not, up to terms of order 1/n,
    interval: from m − σ/√n · g⁻¹(t_{n−1}) to m − σ/√n · g⁻¹(−t_{n−1}),                                  (2)
    g⁻¹(z) = (3/a) ((1 + a (z − a/6))^⅓ − 1)

(Hall, "On the removal of skewness by transformation", J. R. Statist. Soc. B 1992, whose normal quantile is replaced by
Student's). docs/accuracy.md has the measured coverage of (1), (2) and (3).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, special, stats

from quadpend_gym.core.arrays import Booleans, Floats

CONFIDENCE = 0.95
_SIGN_CHOICES = 9999  # of the randomisation test
_BLOCK_NUMBERS = 2_000_000  # random numbers in memory at a time
_ROUNDING = 1e-12  # relative standard deviation below which values count as equal
_STEP = 1e-7  # of a share, from the observed loss to where the root of (3) is sought: rounding hides smaller ones
_SMALLEST_P = 1e-12  # smaller p-values over several seeds are reported as this one
_TAIL_FACTOR = 0.25 / stats.norm.sf(np.sqrt(2.0))  # 3.178, of Bentkus and Dzindzalieta's bound


class Interval(NamedTuple):
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Interval":
        """Return the interval in another unit."""
        return Interval(*(factor * x for x in self))

    def clipped(self, low: float, high: float = np.inf) -> "Interval":
        """Return the interval with its ends clipped to the range of the quantity."""
        return Interval(self.value, *(float(np.clip(x, low, high)) for x in self[1:]))

    def widened(self, other: "Interval") -> "Interval":
        """Return the same estimate with the lower of the two lower ends and the higher of the two higher ends."""
        return Interval(self.value, min(self.low, other.low), max(self.high, other.high))


def _flights(values: Any) -> Floats:
    """Return values of shape (s, n) or (s, c, n) with the shape (s, c, n)."""
    array = np.asarray(values, np.float64)
    return array.reshape(len(array), -1, array.shape[-1])


def design_effect(flights: Floats) -> float:
    """Return (4) of values of shape (s, c, n); s seeds count as one that has their mean."""
    means = flights.mean(axis=0)
    variance = means.var()
    return max(len(means) * float(means.mean(axis=0).var() / variance), 1.0) if variance else 1.0


def proportion(successes: Booleans) -> Interval:
    """Share of successes, shape (s, n) or (s, c, n), with Wilson's interval.

    For several seeds, Wilson's interval is that of all s c n flights, widened by (1). The interval has a positive width
    even if every episode is a success.
    """
    flights = _flights(successes)
    p, n, z = float(flights.mean()), flights.size / design_effect(flights), stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)
    centre, half = p + 0.5 * z**2 / n, z * np.sqrt((p * (1.0 - p) + 0.25 * z**2 / n) / n)
    low, high = np.array([centre - half, centre + half]) / (1.0 + z**2 / n)
    pooled = Interval(p, float(np.clip(low, 0.0, p)), float(np.clip(high, p, 1.0)))  # rounding moves the ends beyond
    return pooled if len(flights) == 1 else pooled.widened(mean(flights.mean(axis=1)).clipped(0.0, 1.0))


def least_proportion(successes: Booleans) -> float:
    """Lower one-sided 95 % bound of the share of successes, shape (s, n) or (s, c, n).

    It is Clopper and Pearson's of c n flights, which holds for any share; for several seeds at most that of (1). Seeds
    fly the same episodes, so s of them count as one that has their mean.
    """
    flights = _flights(successes)
    n, share = flights[0].size / design_effect(flights), float(flights.mean())
    exact = special.betaincinv(n * share, n * (1.0 - share) + 1.0, 1.0 - CONFIDENCE) if share else 0.0
    return min(float(exact), -_bound(-flights.mean(axis=1)))


def largest_loss(successes: Booleans, others: Booleans) -> float:
    """Upper one-sided 95 % bound of the share of the others minus that of successes, in the same episodes.

    The shapes are (s, n) or (s, c, n), with s = 1 for a controller. The bound is the largest Δ that the score test of
    all N = c n pairs does not reject, of which b are lost (only the other succeeds) and g gained:

        b − g − NΔ + z √(N (2q + Δ (1 − Δ))) = 0,                                                        (3)

    with the normal quantile z and the maximum-likelihood estimate q of the probability of a gain if the loss is Δ
    (Tango, "Equivalence test and confidence interval for the difference in proportions for the paired-sample design",
    Statistics in Medicine 1998). Without a discordant pair it is z²/(N + z²), so below 1 % from 268 pairs on. For
    several seeds, which count as one, it is at least that of (1), with the two additional flights of `p_proportion`.
    """
    differences = _flights(others) - _flights(successes)
    counted = len(differences) * design_effect(differences)
    n, lost, gained = (
        float(np.sum(x)) / counted for x in (np.ones_like(differences), differences > 0.0, differences < 0.0)
    )
    z, observed = stats.norm.ppf(CONFIDENCE), (lost - gained) / n

    def excess(loss: float) -> float:
        known, linear = loss * (1.0 - loss), (2 * n - lost + gained) * loss - lost - gained
        q = (np.sqrt(max(linear**2 + 8.0 * n * gained * known, 0.0)) - linear) / (4.0 * n)
        return float(lost - gained - n * loss + z * np.sqrt(max(n * (2.0 * q + known), 0.0)))

    pooled = optimize.brentq(excess, observed + _STEP, 1.0) if observed < 1.0 - _STEP else 1.0
    return min(max(float(pooled), _bound(_with_two_flights(differences))), 1.0)


def _bound(values: Floats) -> float:
    """Return the upper one-sided bound of the mean by (1), which a single seed does not have: −∞."""
    if len(values) == 1:
        return -np.inf
    centre, half_width = _random_effects(values)
    return centre + half_width(2.0 * (1.0 - CONFIDENCE))


def _with_two_flights(differences: Floats) -> Floats:
    """Return means over c scenarios, with an episode in one of which only one policy succeeds, and an opposite one.

    The shapes are (s, c, n) and (s, n + 2).
    """
    seeds, scenarios, _ = differences.shape
    return np.hstack([differences.mean(axis=1), np.tile([1.0 / scenarios, -1.0 / scenarios], (seeds, 1))])


def mean(values: Floats) -> Interval:
    """Mean of values of shape (s, n), with the interval (2) for one seed and (1) for several.

    All seeds that have a value have the same weight. If only one of several seeds has a value, the interval is that of
    one seed. The ends of the interval are nan for a single value, and the mean is nan if there are no values.

    The interval only uses the values in the sample. An event rarer than about 3/n may not be in the sample, and the
    interval then does not account for it, however large its effect is.
    """
    seeds = values[~np.isnan(values).all(axis=1)]
    if not seeds.size:
        return Interval(np.nan, np.nan, np.nan)
    if len(seeds) == 1:
        return _mean_of_one_seed(seeds[~np.isnan(seeds)])
    centre, half_width = _random_effects(seeds)
    half = half_width(1.0 - CONFIDENCE)
    return Interval(centre, centre - half, centre + half)


def _mean_of_one_seed(values: Floats) -> Interval:
    """Mean of values of shape (n,) with the interval (2)."""
    centre = float(values.mean())
    if values.size == 1:
        return Interval(centre, np.nan, np.nan)
    spread = values.std()
    skewness = np.mean((values - centre) ** 3) / spread**3 if spread > _ROUNDING * np.abs(values).max() else 0.0
    a = skewness / np.sqrt(values.size)
    quantile = special.stdtrit(values.size - 1.0, (1 + CONFIDENCE) / 2)
    z = np.array([quantile, -quantile]) - a / 6.0
    root = np.cbrt(1.0 + a * z)
    inverse = 3.0 * z / (root**2 + root + 1.0)  # equals (3/a) (root − 1), also where a is zero
    low, high = centre - spread / np.sqrt(values.size - 1.0) * inverse
    return Interval(centre, float(low), float(high))


def _random_effects(values: Floats) -> tuple[float, Callable[[float], float]]:
    """Return the mean of at least two seeds that each have a value, and half the width of its interval (1).

    The width is a function of 1 − confidence. An effect with a single level, such as that of one episode, is left out.
    """
    seeds = np.nanmean(values, axis=1)
    episodes = np.nanmean(values[:, ~np.isnan(values).all(axis=0)], axis=0)
    means = [x for x in (seeds, episodes) if x.size > 1]
    variances, freedom = np.array([(x.var(ddof=1) / x.size, x.size - 1.0) for x in means]).T
    return float(seeds.mean()), lambda level: float(
        np.sqrt(np.sum(special.stdtrit(freedom, 0.5 * level) ** 2 * variances))
    )


def p_value(differences: Floats) -> float:
    """p-value of the hypothesis that the mean difference is zero, two-sided, shape (s, n).

    For several seeds it is the level at which the interval (1) of the mean reaches zero, and 1 if fewer than two seeds
    have a value.

    For one seed it is the randomisation test, which compares the mean with the means under 9999 random choices of the
    signs. The null hypothesis is that both signs of an episode's difference are equally likely. The test is then valid
    for any number of episodes and for heavy tails; docs/accuracy.md has its level for skewed differences.

    If no choice of signs is as extreme as the observed one, the p-value is the smaller of 1/10000 and an upper bound on
    the share of all 2ⁿ choices that are as extreme: 3.178 times the normal distribution's tails (Bentkus and
    Dzindzalieta, "A tight Gaussian bound for weighted sums of Rademacher random variables", Bernoulli 2015). So the
    p-value can be small enough for a correction for many tests.
    """
    seeds = differences[~np.isnan(differences).all(axis=1)]
    if len(differences) > 1:
        return _p_value_over_seeds(*_random_effects(seeds)) if len(seeds) > 1 else 1.0
    values = np.nan_to_num(differences[0])
    if not values.any():
        return 1.0
    random, blocks = np.random.default_rng([2, values.size]), 1 + _SIGN_CHOICES * values.size // _BLOCK_NUMBERS
    rows = map(len, np.array_split(np.arange(_SIGN_CHOICES), blocks))
    sums = np.concatenate([(2.0 * random.integers(2, size=(n, values.size)) - 1.0) @ values for n in rows])
    extreme = np.sum(np.abs(sums) >= abs(values.sum()) * (1.0 - 1e-9))
    tails = 2.0 * _TAIL_FACTOR * stats.norm.sf(abs(values.sum()) / np.linalg.norm(values))
    return float((extreme + 1) / (_SIGN_CHOICES + 1) if extreme else min(1.0 / (_SIGN_CHOICES + 1), tails))


def _p_value_over_seeds(centre: float, half_width: Callable[[float], float]) -> float:
    """Return the level at which the interval (1) reaches zero."""
    distance = abs(centre)
    if distance <= half_width(1.0):  # zero but for rounding: SciPy before 1.17 has t(1/2) = 1e-17
        return 1.0
    if half_width(_SMALLEST_P) <= distance:
        return _SMALLEST_P
    log = optimize.brentq(lambda log: half_width(np.exp(log)) - distance, np.log(_SMALLEST_P), 0.0)
    return float(np.exp(log))


def p_proportion(successes: Booleans, others: Booleans) -> float:
    """p-value of the hypothesis that two shares of successes are equal, shapes (s, n) and (1, n) or equal.

    For one seed of both it is the randomisation test over all choices of signs, which is McNemar's exact test. For
    several seeds it is `p_value` with two additional flights: one in which all seeds of the first policy succeed and
    the other fails, and one with the opposite result. They prevent a false rejection where failures are rare: a
    controller may have no failure in its n episodes by chance, and its comparison with many seeds repeats that chance.
    """
    if len(successes) > 1 or len(others) > 1:
        return p_value(_with_two_flights(_flights(successes) - _flights(others)))
    gained, lost = int(np.sum(successes & ~others)), int(np.sum(~successes & others))
    return float(min(1.0, 2.0 * stats.binom.cdf(min(gained, lost), gained + lost, 0.5)))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple tests by Holm's method, in the order of `p_values`."""
    order = np.argsort(p_values, kind="stable")
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(np.arange(len(order), 0, -1) * np.take(p_values, order)))
    return [float(p) for p in corrected]
