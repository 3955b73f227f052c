"""Random streams: they equal SplitMix64, have the stated distributions, and are independent of each other."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import stats

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.streams import (
    REFERENCE_STREAM,
    START_STREAM,
    WIND_STREAM,
    Streams,
    normal_pair,
    uniform,
    uniform_between,
)

PURPOSES = [START_STREAM, REFERENCE_STREAM, WIND_STREAM]


def correlations(numbers: Floats) -> Floats:
    """Return the correlation coefficients of different rows, shape (n (n−1) / 2,)."""
    return np.asarray(np.corrcoef(numbers))[np.triu_indices(len(numbers), 1)]


def streams_of(seeds: int, episodes: int) -> Streams:
    """Return the streams of seeds, episodes and three purposes."""
    roots = Streams.from_seeds(list(range(seeds)))
    keys = [roots.derive(episode).derive(purpose).keys for episode in range(episodes) for purpose in PURPOSES]
    return Streams(np.concatenate(keys))


def test_a_stream_is_splitmix64_read_by_index() -> None:
    """The generator's published outputs for the seed 1234567 are the reference."""
    outputs = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    for index, output in enumerate(outputs):
        assert uniform(np.uint64(1234567), index) == ((output >> 12) + 0.5) / 2**52
    assert uniform_between(np.uint64(11), 5, -2.0, 3.0) == -2.0 + 5.0 * uniform(np.uint64(11), 5)


@pytest.mark.parametrize("seed", [0, 2**32])
def test_numbers_of_a_stream_and_first_numbers_of_episodes_are_uniform_and_normal(seed: int) -> None:
    one, episodes = Streams.from_seeds([seed]), Streams.from_seeds([seed] * 100_000).derive(np.arange(100_000))
    for numbers in (one.uniform(0, 100_000)[0], episodes.uniform(0, 1)[:, 0]):
        assert 0.0 < numbers.min() < numbers.max() < 1.0
        assert stats.kstest(numbers, "uniform").pvalue > 0.01
    for numbers in (one.normal(0, 100_000)[0], episodes.normal(0, 2).ravel()):
        assert stats.kstest(numbers, "norm").pvalue > 0.01
        assert stats.kstest(numbers[::2] ** 2 + numbers[1::2] ** 2, "chi2", args=(2,)).pvalue > 0.01


@pytest.mark.parametrize("draw", ["uniform", "normal"])
def test_streams_of_different_seeds_episodes_and_purposes_are_uncorrelated(draw: str) -> None:
    n = 100_000
    numbers = getattr(streams_of(4, 4), draw)(0, n)
    # 1128 coefficients, each nearly normal with a deviation of 1/√n: none is five deviations from zero.
    assert np.abs(correlations(numbers)).max() < 5.0 / np.sqrt(n)
    successive = [correlations(np.stack([row[1:], row[:-1]]))[0] for row in numbers]
    assert np.abs(successive).max() < 5.0 / np.sqrt(n)


def test_streams_do_not_overlap() -> None:
    """All streams are parts of one sequence of 2⁶⁴ numbers. Their first 10 000 numbers have none in common."""
    numbers = streams_of(4, 4).uniform(0, 10_000)
    assert np.unique(numbers).size == numbers.size
    assert np.unique(streams_of(50, 100).keys).size == 50 * 100 * len(PURPOSES)


def test_blocks_are_consecutive_numbers_and_do_not_depend_on_other_streams() -> None:
    many = Streams.from_seeds(list(range(20))).derive(np.arange(20))
    for row in (0, 19):
        alone = Streams.from_seeds([row]).derive(row)
        for draw in ("uniform", "normal"):
            together = getattr(many, draw)(np.arange(20), 5)
            assert_array_equal(getattr(alone, draw)(np.array([row]), 5)[0], together[row])
    stream = Streams.from_seeds([3])
    key = stream.keys[0]
    assert stream.uniform(2, 3).tolist() == [[uniform(key, index) for index in (6, 7, 8)]]
    assert stream.normal(2, 3).tolist() == [[*normal_pair(key, 4), normal_pair(key, 5)[0]]]
