"""Intervals cover what they say, and tests claim no more than they may."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

from baselines import ADRC
from train.flights import fly
from train.statistics import (
    Interval,
    holm,
    improvement,
    improvement_unpaired,
    interquartile_mean,
    mean,
    p_value,
    paired_proportion,
    proportion,
    wilcoxon,
)


def test_intervals_are_those_of_the_books() -> None:
    successes = np.arange(100)[np.newaxis] < 93
    expected = stats.binomtest(93, 100).proportion_ci(method="wilson")
    assert proportion(successes)[1:] == (expected.low, expected.high)
    values = np.random.default_rng(0).normal(size=(1, 400))
    _, low, high = mean(values)
    half = stats.norm.ppf(0.975) * values.std() / 20.0
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.01)


def test_paired_survival_is_never_certain() -> None:
    """Two policies that fall in the same episodes may still differ; Agresti and Min's interval says by how much."""
    survived = np.arange(200)[np.newaxis] > 3
    value, low, high = paired_proportion(survived, survived)
    assert value == 0.0
    assert (low, high) == pytest.approx((-0.0097, 0.0097), abs=1e-4)
    better = paired_proportion(survived | True, survived)
    assert better.value == pytest.approx(4 / 200)


def test_intervals_of_a_learner_cover_its_training_seeds() -> None:
    """Five seeds that differ by 10 mm have a wider interval than one of them, in however many episodes."""
    random = np.random.default_rng(0)
    seeds = random.normal(0.1, 0.01, (5, 1)) + random.normal(0.0, 0.01, (5, 1000))
    one, five = mean(seeds[:1]), mean(seeds)
    assert one.high - one.low < 0.0015
    assert five.high - five.low > 0.005
    learner = fly([ADRC("paper"), ADRC("matched")], "windy", 4)
    np.testing.assert_array_equal(learner.error[1:], fly([ADRC("matched")], "windy", 4).error)


def test_values_that_are_nan_are_left_out() -> None:
    values = np.random.default_rng(0).normal(size=(1, 60))
    some = values.copy()
    some[0, ::3] = np.nan
    assert mean(some).value == pytest.approx(np.nanmean(some))
    assert mean(some).high - mean(some).low > mean(values).high - mean(values).low
    assert np.isnan(mean(np.full((1, 5), np.nan))).all()
    only = mean(np.array([[1.0, np.nan, np.nan]]))
    assert only == Interval(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("estimate", "draw", "truth"),
    [
        (mean, lambda random: random.gamma(2.0, 1.0, (1, 100)), 2.0),
        (interquartile_mean, lambda random: random.normal(2.0, 1.0, (1, 100)), 2.0),
        (proportion, lambda random: random.random((1, 100)) < 0.9, 0.9),
        (lambda x: paired_proportion(*x), lambda random: random.random((2, 1, 100)) < [[[0.9]], [[0.7]]], 0.2),
        (lambda x: improvement(*x), lambda random: random.normal(0.0, 1.0, (2, 1, 100)), 0.5),
    ],
    ids=["mean", "iqm", "proportion", "paired proportion", "improvement"],
)
def test_intervals_cover_the_truth_as_often_as_they_say(
    estimate: Callable[[Any], Interval], draw: Callable[[np.random.Generator], Any], truth: float
) -> None:
    random = np.random.default_rng(1)
    intervals = [estimate(draw(random)) for _ in range(200)]
    covered = np.mean([low <= truth <= high for _, low, high in intervals])
    assert 0.90 <= covered <= 0.99


def test_intervals_over_seeds_cover_the_learner() -> None:
    """With ten training seeds the truth is that of all seeds there could be, not of these ten."""
    random = np.random.default_rng(2)
    hits = 0
    for _ in range(100):
        seeds = random.normal(1.0, 0.2, (10, 1)) + random.normal(0.0, 0.2, (10, 50))
        _, low, high = mean(seeds)
        hits += low <= 1.0 <= high
    assert hits >= 85


@pytest.mark.parametrize("shape", [(1, 5), (1, 40), (5, 30), (2, 3)])
def test_the_interquartile_mean_is_scipys_trimmed_mean(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(3).gamma(1.0, 1.0, shape)
    assert interquartile_mean(values).value == pytest.approx(stats.trim_mean(values, 0.25, axis=None))
    fallen = values.copy()
    fallen[0, 0] = 1e6
    assert interquartile_mean(fallen).value < 10.0


def test_the_interquartile_means_interval_agrees_with_a_plain_loop() -> None:
    values = np.random.default_rng(4).gamma(1.0, 1.0, (3, 40))
    random = np.random.default_rng(5)
    means = []
    for _ in range(2000):
        drawn = values[random.integers(3, size=3)][:, random.integers(40, size=40)]
        means.append(stats.trim_mean(drawn, 0.25, axis=None))
    assert interquartile_mean(values)[1:] == pytest.approx(tuple(np.quantile(means, [0.025, 0.975])), abs=0.06)


def test_the_probability_of_improvement_counts_pairs() -> None:
    random = np.random.default_rng(6)
    first, second = random.integers(0, 5, (3, 8)) / 1.0, random.integers(0, 5, (3, 8)) / 1.0
    paired = [np.mean([(x < y) + 0.5 * (x == y) for x, y in zip(first.ravel(), second.ravel(), strict=True)])]
    assert improvement(first, second).value == pytest.approx(paired[0])
    everyone = [(x < y) + 0.5 * (x == y) for x, y in itertools.product(first.ravel(), second.ravel())]
    assert improvement_unpaired(first, second) == pytest.approx(np.mean(everyone))
    assert improvement(first, first) == (0.5, 0.5, 0.5)


def test_the_randomisation_test_is_mcnemars_where_it_is_about_survival() -> None:
    differences = np.zeros((1, 100))
    differences[0, :9], differences[0, 9:11] = 1.0, -1.0
    assert p_value(differences) == pytest.approx(stats.binomtest(9, 11).pvalue, abs=0.01)
    assert p_value(np.zeros((1, 100))) == p_value(np.zeros((3, 100))) == 1.0
    assert p_value(np.full((1, 100), 0.1)) == 1e-4


@pytest.mark.parametrize("seeds", [1, 8])
def test_equals_are_told_apart_no_more_often_than_allowed(seeds: int) -> None:
    """In one of twenty comparisons of equals, however skewed the difference; a little more often with few seeds."""
    random = np.random.default_rng(7)
    p = [p_value(random.normal(0.0, 1.0, (seeds, 1)) + random.normal(0.0, 1.0, (seeds, 60)) ** 3) for _ in range(200)]
    if seeds == 1:
        p = [p_value(random.normal(0.0, 1.0, (1, 60)) ** 3) for _ in range(200)]
    assert np.mean(np.array(p) < 0.05) <= (0.09 if seeds == 1 else 0.15)


def test_holms_correction_is_that_of_the_books() -> None:
    """Holm 1979: the smallest p times the number of tests, the next times one less, never falling."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([0.02]) == [0.02]
    random = np.random.default_rng(8)
    assert sum(min(holm(list(random.random(20)))) < 0.05 for _ in range(1000)) <= 70


def test_wilcoxons_test_is_scipys() -> None:
    differences = np.random.default_rng(9).normal(0.2, 1.0, (3, 50))
    assert wilcoxon(differences) == stats.wilcoxon(differences.mean(axis=0)).pvalue
    assert wilcoxon(np.zeros((1, 5))) == 1.0
