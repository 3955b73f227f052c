"""Intervals have their nominal coverage, and tests keep their level."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy import stats

from quadpend_baselines import controller
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.statistics import (
    holm,
    largest_loss,
    least_proportion,
    mean,
    p_proportion,
    p_value,
    proportion,
)


def test_intervals_of_one_policy_agree_with_textbook_formulas() -> None:
    successes = np.arange(100)[np.newaxis] < 93
    expected = stats.binomtest(93, 100).proportion_ci(method="wilson")
    assert proportion(successes)[1:] == pytest.approx((expected.low, expected.high))
    values = np.random.default_rng(0).normal(size=(1, 400))
    _, low, high = mean(values)
    half = stats.norm.ppf(0.975) * values.std() / 20.0
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.01)


def test_the_bounds_of_survival_and_of_its_loss_agree_with_published_formulas_and_limits() -> None:
    """Clopper and Pearson 1934: (1 − 0.95)^(1/n) without a fall. Tango 1998 without a discordant pair: z²/(n + z²)."""
    every, z = np.ones((1, 268), np.bool_), stats.norm.ppf(0.95)
    assert least_proportion(every) == pytest.approx(0.05 ** (1 / 268))
    assert least_proportion(~every) == 0.0
    every_seed = np.ones((5, 268), np.bool_)  # which fly the same episodes
    assert least_proportion(every_seed) == least_proportion(every)
    assert largest_loss(every, every) == pytest.approx(z**2 / (268 + z**2))
    assert largest_loss(every, every) < 0.01 < largest_loss(every[:, 1:], every[:, 1:])
    assert largest_loss(~every, every) == 1.0


@pytest.mark.parametrize("episodes", [1, 2, 50, 268, 3000])
@pytest.mark.parametrize("seeds", [1, 3])
def test_bounds_and_tests_exist_where_all_episodes_are_alike(seeds: int, episodes: int) -> None:
    """Only the other policy falls: Tango's bound is −1 + 2 z²/(n + z²) then."""
    every, z = np.ones((seeds, episodes), np.bool_), stats.norm.ppf(0.95)
    for first, second in product((every, ~every), repeat=2):
        assert first.mean() * (0.05 ** (1.0 / episodes)) == pytest.approx(least_proportion(first))
        assert second.mean() - first.mean() <= largest_loss(first, second) <= 1.0
        assert proportion(first).low <= first.mean() <= proportion(first).high
        assert 0.0 <= p_proportion(first, second) <= 1.0
    if seeds == 1:
        assert largest_loss(every, ~every) == pytest.approx(-1.0 + 2.0 * z**2 / (episodes + z**2))


def test_flights_of_scenarios_that_fall_in_the_same_episodes_count_as_one() -> None:
    """Ten of 200 episodes fall: in all of five scenarios, or each in another episode of every scenario."""
    falls = np.arange(200) < 10
    alike, apart = (np.array([[~np.roll(falls, shift * i) for i in range(5)]]) for shift in (0, 10))
    steady = np.ones((1, 1, 200), np.bool_)
    for bound in (least_proportion, lambda x: proportion(x).low, lambda x: -largest_loss(x, np.ones_like(x))):
        assert bound(alike) == pytest.approx(bound(alike[:, 0]))
        assert bound(apart) == pytest.approx(bound(apart.reshape(1, -1)))
        assert bound(alike) < bound(apart)
    assert least_proportion(alike | steady) == least_proportion(np.ones((1, 1000), np.bool_))


@pytest.mark.parametrize(
    ("shape", "share", "other", "common"),
    [
        ((1, 1, 300), 0.99, 1.0, 0.0),
        ((1, 1, 300), 0.97, 0.98, 0.0),
        ((5, 1, 200), 0.98, 0.99, 0.0),
        ((1, 5, 200), 0.98, 0.99, 0.0),
        ((1, 5, 200), 0.95, 0.97, 0.3),
        ((3, 4, 200), 0.95, 0.97, 1.0),
    ],
)
def test_one_sided_bounds_are_seldom_on_the_wrong_side(
    shape: tuple[int, int, int], share: float, other: float, common: float
) -> None:
    """A part `common` of the episodes has the same result with all seeds in all scenarios."""
    random, wrong = np.random.default_rng(5), np.zeros(2)

    def draw(seeds: int, p: float) -> Any:
        alone, together = random.random((seeds, *shape[1:])), random.random((1, 1, shape[2]))
        return np.where(random.random(shape[2]) < common, together, alone) < p

    for _ in range(400):
        survived, others = draw(shape[0], share), draw(1, other)
        wrong += least_proportion(survived) > share, largest_loss(survived, others) < other - share
    assert (wrong / 400 <= 0.075).all()


def test_the_interval_of_a_learner_accounts_for_the_variance_of_its_training_seeds() -> None:
    """Five seeds that differ by 10 mm have a wider interval than one of them has over 1000 episodes."""
    random = np.random.default_rng(0)
    seeds = random.normal(0.1, 0.01, (5, 1)) + random.normal(0.0, 0.01, (5, 1000))
    one, five = mean(seeds[:1]), mean(seeds)
    assert one.high - one.low < 0.0015
    assert five.high - five.low > 0.005
    learner = run_episodes([controller("adrc-paper"), controller("adrc-matched")], "windy", 4)
    np.testing.assert_array_equal(learner.error[1:], run_episodes([controller("adrc-matched")], "windy", 4).error)


def test_nan_values_are_left_out() -> None:
    values = np.random.default_rng(0).normal(size=(1, 60))
    some = values.copy()
    some[0, ::3] = np.nan
    assert mean(some).value == pytest.approx(np.nanmean(some))
    assert mean(some).high - mean(some).low > mean(values).high - mean(values).low
    assert np.isnan(mean(np.full((1, 5), np.nan))).all()
    only = mean(np.array([[1.0, np.nan, np.nan]]))
    assert only.value == 1.0
    assert np.isnan(only[1:]).all()  # a single value has no interval


def test_the_interval_of_the_mean_is_students_for_symmetric_values_and_longer_towards_the_tail() -> None:
    values = np.concatenate([np.linspace(-1.0, 1.0, 9), [0.0]])
    expected = stats.t.interval(0.95, 9, values.mean(), stats.sem(values))
    assert mean(values[np.newaxis])[1:] == pytest.approx(expected)
    value, low, high = mean(np.random.default_rng(0).exponential(1.0, (1, 30)))
    assert high - value > value - low
    assert mean(np.full((1, 7), 0.1)) == pytest.approx((0.1, 0.1, 0.1), abs=1e-15)


@pytest.mark.parametrize("seeds", [2, 3, 5, 10])
def test_coverage_and_level_hold_for_few_and_for_many_training_seeds(seeds: int) -> None:
    """The true mean is that of the population of seeds, which have the same variance as the episodes."""
    random = np.random.default_rng([2, seeds])
    trials = 600
    covered = rejected = 0
    for _ in range(trials):
        own, common = random.normal(0.0, 1.0, (seeds, 1)), random.normal(0.0, 1.0, (1, 50))
        values = own + common + random.normal(0.0, 1.0, (seeds, 50))
        _, low, high = mean(values)
        covered += low <= 0.0 <= high
        rejected += p_value(values) < 0.05
    assert covered >= 0.93 * trials
    assert rejected <= 0.07 * trials
    assert rejected == trials - covered  # the test and the interval agree


@pytest.mark.parametrize("rate", [0.005, 0.1])
def test_the_test_of_survival_keeps_its_level_for_rare_falls_and_many_training_seeds(rate: float) -> None:
    """A learner with ten seeds and a controller have the same probability of a fall."""
    random = np.random.default_rng(10)
    rejected = covered = 0
    for _ in range(200):
        learner, controller = random.random((10, 200)) > rate, random.random((1, 200)) > rate
        rejected += p_proportion(learner, controller) < 0.05
        covered += largest_loss(learner, controller) >= 0.0
    assert rejected <= 14
    assert covered >= 186


def test_the_randomisation_test_of_survival_is_mcnemars_exact_test() -> None:
    successes, others = np.ones((1, 100), np.bool_), np.ones((1, 100), np.bool_)
    others[0, :9], successes[0, 9:11] = False, False
    assert p_proportion(successes, others) == pytest.approx(stats.binomtest(9, 11).pvalue)
    assert p_value(successes.astype(np.float64) - others) == pytest.approx(stats.binomtest(9, 11).pvalue, abs=0.01)
    assert p_proportion(successes, successes) == p_value(np.zeros((1, 100))) == p_value(np.zeros((3, 100))) == 1.0


@pytest.mark.parametrize("power", [1, 3], ids=["normal", "heavy tails"])
@pytest.mark.parametrize("size", [10, 60])
def test_the_randomisation_test_keeps_its_level(power: int, size: int) -> None:
    random = np.random.default_rng(7)
    p = [p_value(random.normal(0.0, 1.0, (1, size)) ** power) for _ in range(400)]
    assert np.mean(np.array(p) < 0.05) <= 0.07


def test_holms_correction_agrees_with_its_definition() -> None:
    """Holm 1979: multiply the smallest p by the number of tests, the next one by one less, and keep them ascending."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([0.02]) == [0.02]
    random = np.random.default_rng(8)
    assert sum(min(holm(list(random.random(20)))) < 0.05 for _ in range(1000)) <= 70
