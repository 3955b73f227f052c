"""Random streams: they equal SplitMix64, have the stated distributions, and are independent of each other."""

import numpy as np
import pytest
from scipy import stats

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.streams import (
    REFERENCE_STREAM,
    START_STREAM,
    WIND_STREAM,
    Streams,
    normal_pair,
    uniform,
    uniform_between,
)

SEEDS = [0, 1, 2, 2**32]
PURPOSES = [START_STREAM, REFERENCE_STREAM, WIND_STREAM]


def block(streams: Streams, index: int) -> Integers:
    """Return the same block index for every stream."""
    return np.full(streams.keys.shape, index)


def correlations(numbers: Floats) -> Floats:
    """Return the correlation coefficients of different rows, shape (n (n−1) / 2,)."""
    return np.asarray(np.corrcoef(numbers))[np.triu_indices(len(numbers), 1)]


def test_a_stream_is_splitmix64_read_by_index() -> None:
    """The generator's published outputs for the seed 1234567 are the reference."""
    outputs = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    for index, output in enumerate(outputs):
        assert uniform(np.uint64(1234567), index) == ((output >> 12) + 0.5) / 2**52


@pytest.mark.parametrize("seed", SEEDS)
def test_uniform_numbers_are_uniform(seed: int) -> None:
    numbers = Streams.from_seeds([seed]).uniform(np.array([0]), 100_000)[0]
    assert numbers.min() > 0.0
    assert numbers.max() < 1.0
    assert stats.kstest(numbers, "uniform").pvalue > 0.01


@pytest.mark.parametrize("seed", SEEDS)
def test_normal_numbers_are_normal(seed: int) -> None:
    numbers = Streams.from_seeds([seed]).normal(np.array([0]), 100_000)[0]
    assert stats.kstest(numbers, "norm").pvalue > 0.01
    assert stats.kstest(numbers[::2] ** 2 + numbers[1::2] ** 2, "chi2", args=(2,)).pvalue > 0.01


def test_first_numbers_of_successive_episodes_are_uniform_and_normal() -> None:
    episodes = Streams.from_seeds([7] * 100_000).derive(np.arange(100_000)).derive(START_STREAM)
    assert stats.kstest(episodes.uniform(block(episodes, 0), 1)[:, 0], "uniform").pvalue > 0.01
    assert stats.kstest(episodes.normal(block(episodes, 0), 1)[:, 0], "norm").pvalue > 0.01


def all_streams() -> Streams:
    """Return the streams of four seeds, four episodes and three purposes."""
    seeds = Streams.from_seeds(list(range(4)))
    keys = [seeds.derive(episode).derive(purpose).keys for episode in range(4) for purpose in PURPOSES]
    return Streams(np.concatenate(keys))


@pytest.mark.parametrize("draw", ["uniform", "normal"])
def test_streams_of_different_seeds_episodes_and_purposes_are_uncorrelated(draw: str) -> None:
    streams, n = all_streams(), 100_000
    numbers = getattr(streams, draw)(block(streams, 0), n)
    # 1128 coefficients, each nearly normal with a deviation of 1/√n: none is five deviations from zero.
    assert np.abs(correlations(numbers)).max() < 5.0 / np.sqrt(n)
    successive = [correlations(np.stack([row[1:], row[:-1]]))[0] for row in numbers]
    assert np.abs(successive).max() < 5.0 / np.sqrt(n)


def test_streams_do_not_overlap() -> None:
    """All streams are parts of one sequence of 2⁶⁴ numbers. Their first 10 000 numbers have none in common."""
    streams = all_streams()
    numbers = streams.uniform(block(streams, 0), 10_000)
    assert np.unique(numbers).size == numbers.size


def test_streams_of_different_seeds_episodes_and_purposes_have_different_keys() -> None:
    seeds = Streams.from_seeds(list(range(50)))
    keys = [seeds.derive(episode).derive(purpose).keys for episode in range(100) for purpose in PURPOSES]
    assert np.unique(np.concatenate(keys)).size == 50 * 100 * len(PURPOSES)


def test_numbers_of_a_stream_do_not_depend_on_the_other_streams_of_the_batch() -> None:
    many = Streams.from_seeds(list(range(20))).derive(np.arange(20))
    for row in (0, 7, 19):
        alone = Streams.from_seeds([row]).derive(row)
        for draw in ("uniform", "normal"):
            together = getattr(many, draw)(np.arange(20), 5)[row]
            assert np.array_equal(getattr(alone, draw)(np.array([row]), 5)[0], together)
            assert np.array_equal(getattr(many[row : row + 1], draw)(np.array([row]), 5)[0], together)


def test_blocks_are_consecutive_numbers_of_the_stream() -> None:
    stream = Streams.from_seeds([3])
    key = stream.keys[0]
    assert stream.uniform(np.array([2]), 3).tolist() == [[uniform(key, index) for index in (6, 7, 8)]]
    pairs = [normal_pair(key, index) for index in (4, 5)]
    assert stream.normal(np.array([2]), 4).tolist() == [[*pairs[0], *pairs[1]]]
    assert stream.normal(np.array([2]), 3).tolist() == [[*pairs[0], pairs[1][0]]]


def test_uniform_between_scales_the_uniform_number_of_the_same_index() -> None:
    key = np.uint64(11)
    assert uniform_between(key, 5, -2.0, 3.0) == -2.0 + 5.0 * uniform(key, 5)
