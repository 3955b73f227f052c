"""Random numbers as a pure function of (seed, episode, stream, index).

A stream is a 64-bit key. Its n-th number, n = 0, 1, …, is ``mix(key + (n + 1)·γ)``: the SplitMix64 generator (Steele,
Lea & Flood, OOPSLA 2014) with random access. The function ``mix`` also derives the keys of substreams, so every
sub-environment, episode and purpose has its own stream. The random numbers of episode k therefore depend only on the
seed and on k; they do not depend on the number of sub-environments, on the policy, or on other draws.

The uniform and the normal numbers of one stream are computed from the same bits. Code that needs independent uniform
and normal numbers must derive two streams.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadpend_gym.core.elementary import log, sincos
from quadpend_gym.core.jit import compiled, inlined

Keys = NDArray[np.uint64]

# Each purpose has its own stream, so that adding wind does not change starts and references.
START_STREAM, REFERENCE_STREAM, WIND_STREAM, SENSOR_STREAM, ACTUATOR_STREAM, PARAMETER_STREAM, LOOP_STREAM = range(1, 8)
JUMP_STREAM = 8

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_TWO_PI = 2.0 * np.pi


@inlined
def _mix(x: Any) -> Any:
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@inlined
def derive(key: Any, number: int) -> Any:
    """Return the key of the `number`-th substream of the stream `key`."""
    return _mix(_mix(key) + np.uint64(number) * _GAMMA)


@inlined
def uniform(key: Any, index: int) -> float:
    """Return the `index`-th number of a stream, uniform in (0, 1)."""
    bits = _mix(key + (np.uint64(index) + np.uint64(1)) * _GAMMA)
    return (float(np.int64(bits >> np.uint64(12))) + 0.5) * 2.0**-52


@inlined
def uniform_between(key: Any, index: int, low: float, high: float) -> float:
    """Return the `index`-th number of a stream, uniform between `low` and `high`."""
    return low + (high - low) * uniform(key, index)


@inlined
def normal_pair(key: Any, index: int) -> tuple[float, float]:
    """Return the `index`-th pair of independent standard normal numbers of a stream (Box–Muller)."""
    radius = np.sqrt(-2.0 * log(uniform(key, 2 * index)))
    sine, cosine = sincos(_TWO_PI * uniform(key, 2 * index + 1))
    return radius * cosine, radius * sine


@compiled
def _derive_all(keys: Keys, numbers: NDArray[np.int64], out: Keys) -> None:
    for row in range(keys.shape[0]):
        out[row] = derive(keys[row], numbers[row])


@compiled
def _fill_uniform(keys: Keys, index: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    columns, rows = out.shape
    for column in range(columns):
        for row in range(rows):
            out[column, row] = uniform(keys[row], index[row] * columns + column)


@compiled
def _fill_normal(keys: Keys, index: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    columns, rows = out.shape
    pairs = columns // 2
    for pair in range(pairs):
        for row in range(rows):
            first, second = normal_pair(keys[row], index[row] * pairs + pair)
            out[2 * pair, row] = first
            out[2 * pair + 1, row] = second


@dataclass(frozen=True)
class Streams:
    """A batch of n random streams, usually one for each sub-environment."""

    keys: Keys  # shape (n,)

    @classmethod
    def from_seeds(cls, seeds: list[int]) -> "Streams":
        """Return one stream for each of the seeds, which are non-negative integers."""
        states = [np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] for seed in seeds]
        return cls(np.array(states, np.uint64))

    def derive(self, numbers: int | NDArray[np.int64]) -> "Streams":
        """Return one substream of each stream: the one of this number, or of the numbers of shape (n,)."""
        out = np.empty_like(self.keys)
        _derive_all(self.keys, self._as_array(numbers), out)
        return Streams(out)

    def __getitem__(self, rows: Any) -> "Streams":
        return Streams(self.keys[rows])

    def uniform(self, index: int | NDArray[np.int64], columns: int) -> NDArray[np.float64]:
        """Draw a block of numbers uniform in (0, 1) from each stream, shape (n, columns).

        The number of the block, `index`, is one integer for all streams, or an array of shape (n,).
        """
        out = np.empty((columns, self.keys.shape[0]))
        _fill_uniform(self.keys, self._as_array(index), out)
        return out.T

    def between(self, index: int | NDArray[np.int64], lowest: Any, highest: Any) -> NDArray[np.float64]:
        """Draw numbers uniform between bounds of shape (columns,), shape (n, columns); `index` is as in `uniform`."""
        low, high = np.asarray(lowest), np.asarray(highest)
        return np.asarray(low + (high - low) * self.uniform(index, low.size))

    def normal(self, index: int | NDArray[np.int64], columns: int) -> NDArray[np.float64]:
        """Draw standard normal numbers; see `uniform` for the arguments and the result.

        A block with an odd number of columns uses as many numbers of the stream as a block with one more column.
        """
        out = np.empty((columns + columns % 2, self.keys.shape[0]))
        _fill_normal(self.keys, self._as_array(index), out)
        return out[:columns].T

    def _as_array(self, index: int | NDArray[np.int64]) -> NDArray[np.int64]:
        return np.full(self.keys.shape, index) if isinstance(index, int) else index
