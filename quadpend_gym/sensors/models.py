"""Sensors: what is measured of the state before it is observed.

A sensor changes the measured state, laid out as in `quadpend_gym.physics.state`: noise on ζ, ζ̇, η, η̇, r and ṙ in their units.
The observation is computed from it and the reference of the present: noise of the direction r moves the bob whose
tracking error is observed, and a delayed position is compared with where the reference is now. Reward, termination and
``info`` keep to the true state. Sensors work in order: ``[Noise(position=0.002), Delay(2)]`` delays noisy samples.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats, Integers
from quadpend_gym.core.delays import check_steps, delay
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.models import Model, Registry, ZeroInitialized
from quadpend_gym.core.streams import Keys, Streams, normal_pair
from quadpend_gym.core.validation import check_number, from_plain, to_plain_fields
from quadpend_gym.physics.state import DIRECTION, STATE_FIELDS, STATE_SIZE


@runtime_checkable
class Sensor(Model, Protocol):
    """What a sensor model must be able to do, for a batch of n rows. No base class is needed."""

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Change what is measured at this instant.

        Args:
            measured: shape (n, 18), columns contiguous, changed in place.
            memory: shape (n, memory_size), columns contiguous, updated in place.
            step: control steps since each row's episode began, shape (n,): 0 for the observation of a reset.
            period: of a control step, s.
            streams: the rows' random streams; from block 1 on.
        """


SENSORS = Registry("sensor", "a sensor model", Sensor)  # `registry` adds the kinds


@dataclass(frozen=True)
class Channel:
    """Errors of the three components of one field of the state, in the field's unit; of the same size in each.

    Raises:
        TypeError: a value is not a number.
        ValueError: a value is negative or not finite.
    """

    white: float = 0.0  # standard deviation of a new error at each sample
    bias: float = 0.0  # standard deviation of a constant error, drawn for each episode
    walk: float = 0.0  # standard deviation that a random walk gains in 1 s
    quantum: float = 0.0  # what is measured is rounded to whole multiples of it

    def __post_init__(self) -> None:
        to_plain_fields(self)
        for item in fields(self):
            check_number(getattr(self, item.name), item.name, 0.0, 1e6)


def _as_channel(value: Any, name: str) -> Channel:
    return (
        from_plain(Channel, value, name)
        if isinstance(value, Channel | Mapping)
        else Channel(check_number(value, name, 0.0, 1e6))
    )


@dataclass(frozen=True)
class Noise:
    """Measurement errors: white noise, bias, random walk, and quantisation after them.

    Each field takes a `Channel`, a mapping of its fields, or a number: the standard deviation of white noise. A noisy
    direction is normalised (before it is rounded), so its error is an angle in rad.

    Raises:
        TypeError: a value is none of these.
        ValueError: a value is out of range, or nothing is noisy.
    """

    position: Any = 0.0  # m
    velocity: Any = 0.0  # m/s
    euler: Any = 0.0  # rad
    euler_rate: Any = 0.0  # rad/s
    direction: Any = 0.0  # rad
    direction_rate: Any = 0.0  # 1/s
    kind: str = field(default="noise", init=False)

    def __post_init__(self) -> None:
        for name in STATE_FIELDS:
            object.__setattr__(self, name, _as_channel(getattr(self, name), name))
        if not any(self._sizes(item.name).any() for item in fields(Channel)):
            raise ValueError("noise must be on at least one field of the state; all are 0")

    def _sizes(self, what: str) -> Floats:
        """One of a channel's numbers for every column of the state, shape (18,)."""
        sizes = np.zeros(STATE_SIZE)
        for name, columns in STATE_FIELDS.items():
            sizes[columns] = getattr(getattr(self, name), what)
        return sizes

    @cached_property
    def _plan(self) -> "_NoisePlan":
        white, bias, walk = (self._sizes(what) for what in ("white", "bias", "walk"))
        columns = np.flatnonzero(white + bias + walk)
        quantum = self._sizes("quantum")
        return _NoisePlan(
            columns,
            white[columns],
            bias[columns],
            walk[columns],
            quantum,
            np.flatnonzero(quantum),
            drifts=bool(bias.any() or walk.any()),
            walks=bool(walk.any()),
            turns=bool(self.direction.white or self.direction.bias or self.direction.walk),
        )

    @property
    def memory_size(self) -> int:
        """The present bias and walk of each noisy column, if there are any."""
        return self._plan.columns.size if self._plan.drifts else 0

    def initial_memory(self, streams: Streams) -> Floats:
        """The biases."""
        plan = self._plan
        if not plan.drifts:
            return np.empty((streams.keys.size, 0))
        return plan.bias * streams.normal(0, plan.columns.size)

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the errors, then round; block 2 · step + 1 has the white noise, block 2 · step + 2 the walk's step."""
        plan = self._plan
        if plan.columns.size:
            _add_normal(streams.keys, 2 * step + 1, plan.columns, plan.white, measured.T)
        if plan.drifts:
            for i, column in enumerate(plan.columns):
                measured[:, column] += memory[:, i]
        if plan.walks:
            places = np.arange(plan.columns.size)
            _add_normal(streams.keys, 2 * step + 2, places, np.sqrt(period) * plan.walk, memory.T)
        if plan.turns:
            _normalise(measured.T)
        for column in plan.rounded:
            measured[:, column] = plan.quantum[column] * np.rint(measured[:, column] / plan.quantum[column])


@dataclass(frozen=True)
class _NoisePlan:
    """A `Noise` column by column: the columns with errors and their sizes, and what is rounded."""

    columns: Integers
    white: Floats
    bias: Floats
    walk: Floats
    quantum: Floats
    rounded: Integers
    drifts: bool
    walks: bool
    turns: bool


@inlined
def _add_pair(keys: Any, index: Any, pairs: int, pair: int, deviation: Any, one: Any, other: Any) -> None:
    for row in range(keys.size):
        first, second = normal_pair(keys[row], index[row] * pairs + pair)
        one[row] += deviation[0] * first
        other[row] += deviation[1] * second


@compiled
def _add_normal(keys: Keys, index: Integers, columns: Integers, deviation: Floats, out: Floats) -> None:
    """Add normal numbers to rows `columns` of `out`, shape (k, n): one at a time, or the loops do not vectorise."""
    pairs = (columns.size + 1) // 2
    for pair in range(columns.size // 2):
        one, other = columns[2 * pair], columns[2 * pair + 1]
        _add_pair(keys, index, pairs, pair, deviation[2 * pair : 2 * pair + 2], out[one], out[other])
    if columns.size % 2:
        last = np.array([deviation[-1], 0.0])
        _add_pair(keys, index, pairs, pairs - 1, last, out[columns[-1]], np.zeros(keys.size))


@compiled
def _normalise(measured: Floats) -> None:
    for row in range(measured.shape[1]):
        x, y, z = measured[DIRECTION, row], measured[DIRECTION + 1, row], measured[DIRECTION + 2, row]
        size = 1.0 / np.sqrt(x * x + y * y + z * z)
        measured[DIRECTION, row] = size * x
        measured[DIRECTION + 1, row] = size * y
        measured[DIRECTION + 2, row] = size * z


@dataclass(frozen=True)
class Delay(ZeroInitialized):
    """What is measured was so a number of control steps ago; until then, what was measured at the reset.

    Raises:
        ValueError: `steps` is not a whole number from 1 to 1000.
    """

    steps: int = 1
    kind: str = field(default="delay", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_steps(self.steps)

    @property
    def memory_size(self) -> int:
        """The measurements of the last steps."""
        return self.steps * STATE_SIZE

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The sample of `steps` steps ago."""
        _fill(measured, memory, step == 0)
        delay(measured, step, memory, self.steps)


def _fill(measured: Floats, memory: Floats, fresh: Booleans) -> None:
    """Remember in rows that begin their first sample as if it had always been so."""
    if fresh.any():
        memory[fresh] = np.tile(measured[fresh], memory.shape[1] // measured.shape[1])


@dataclass(frozen=True)
class Dropout(ZeroInitialized):
    """Each sample but an episode's first is lost with a probability; then the one before stands.

    Raises:
        TypeError: `probability` is not a number.
        ValueError: it is outside [0, 1].
    """

    probability: float = 0.1
    kind: str = field(default="dropout", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_number(self.probability, "probability", 0.0, 1.0)

    @property
    def memory_size(self) -> int:
        """The sample that came through last."""
        return STATE_SIZE

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The latest sample that came through."""
        _fill(measured, memory, step == 0)
        lost = streams.uniform(step + 1, 1)[:, 0] < self.probability
        measured[lost] = memory[lost]
        memory[:] = measured
