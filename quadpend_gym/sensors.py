"""Sensor models: they change the measured state from which the observation is computed.

The measured state has the layout of `quadpend_gym.physics.state`; a sensor adds errors to ζ, ζ̇, η, η̇, r and ṙ in their
units. The observation is computed from the measured state and the current reference. Consequently, noise of the
direction r also changes the observed tracking error of the bob, and a delayed position is compared with the current
reference. Reward, termination and ``info`` use the true state.

Behind the state, a measurement has the age of the sample (s), which is 0 before the first sensor. A sensor that gives
an old sample again says how old it is; one that delays every sample, or that is frozen, does not.

Several sensors act in the order in which they are listed: ``[Noise(position=0.002), Delay(2)]`` delays noisy samples.
"""

from dataclasses import fields
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.delays import delay, hold
from quadpend_gym.core.events import Events, Interruptions, next_events, take_due
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.core.models import FromFactory, Model, Registry, ZeroInitialized
from quadpend_gym.core.settings import Interval, Parsed, Range, parse, settings
from quadpend_gym.core.streams import Keys, Streams, normal_pair
from quadpend_gym.physics.state import DIRECTION, EULER, STATE_FIELDS, STATE_SIZE

AGE, MEASURED_SIZE = STATE_SIZE, STATE_SIZE + 1  # column of the age, and number of columns of a measurement
_LEVEL_STREAM = 1  # substream of the level of a `Noise`
Part = Literal["position", "attitude", "pole"]
PARTS: dict[Part, slice] = {
    "position": slice(0, EULER),
    "attitude": slice(EULER, DIRECTION),
    "pole": slice(DIRECTION, AGE),
}


@runtime_checkable
class Sensor(Model, Protocol):
    """The interface of a sensor model, for a batch of n sub-environments. A base class is not needed."""

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Change the measurements of the current control step, shape (n, 19), columns contiguous, in place.

        A measurement is the state, with the layout of `quadpend_gym.physics.state`, and the age of the sample in s.
        The other arguments are those of `Wind.sample`. `step` is 0 for the observation of a reset, and all blocks of
        the random streams from 1 on may be used.
        """


@settings
class SensorFromFactory(FromFactory):
    """The sensors that a function or class of the user's own code returns."""

    @cached_property
    def parts(self) -> Any:
        """The models that the factory returns."""
        return SENSORS.make_own(self.kind)

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Change the measurements, each model in its turn."""
        self.each(memory, streams, lambda model, own, random: model.sense(measured, own, step, period, random))


SENSORS = Registry("sensor", Sensor, SensorFromFactory)
SensorsField = SENSORS.field()  # annotation of a field that holds a tuple of sensors
as_sensors, KINDS = SENSORS.parse, SENSORS.kinds


@settings
class Channel:
    """Sizes of the measurement errors of each component of one field of the state, in the unit of this field."""

    white: Annotated[float, Range(0.0, 1e6)] = 0.0  # standard deviation of white noise, independent at each sample
    bias: Annotated[float, Range(0.0, 1e6)] = 0.0  # standard deviation of a constant error, drawn for each episode
    walk: Annotated[float, Range(0.0, 1e6)] = 0.0  # standard deviation of a random walk after 1 s
    # step of the quantisation: the measurement is rounded to its multiples
    quantum: Annotated[float, Range(0.0, 1e6)] = 0.0


ErrorsField = Parsed(
    lambda value: Channel(value) if isinstance(value, int | float) else parse(Channel, value, "Channel"),
    lambda: Channel | float,
)


@SENSORS.add
@settings
class Noise:
    """Measurement errors: white noise, bias, random walk, and then quantisation.

    Each field takes a `Channel`, a mapping of the fields of a `Channel`, or a number, which is the standard deviation
    of white noise. The noisy direction is normalised before it is rounded, so the size of its noise is an angle in rad.
    """

    position: Annotated[Any, ErrorsField] = Channel()  # m
    velocity: Annotated[Any, ErrorsField] = Channel()  # m/s
    euler: Annotated[Any, ErrorsField] = Channel()  # rad
    euler_rate: Annotated[Any, ErrorsField] = Channel()  # rad/s
    direction: Annotated[Any, ErrorsField] = Channel()  # rad
    direction_rate: Annotated[Any, ErrorsField] = Channel()  # 1/s
    # factor on all errors, drawn for each episode, uniform in this interval; None: 1
    level: Annotated[Interval | None, Range(1e-3, 1e3)] = None
    kind: Literal["noise"] = "noise"

    def __post_init__(self) -> None:
        if not any(self._sizes(item.name).any() for item in fields(Channel)):
            raise ValueError("noise must be on at least one field of the state; all are 0")

    def _sizes(self, error: str) -> Floats:
        """Return one field of `Channel` for every column of the state, shape (18,)."""
        sizes = np.zeros(STATE_SIZE)
        for name, columns in STATE_FIELDS.items():
            sizes[columns] = getattr(getattr(self, name), error)
        return sizes

    @cached_property
    def _columns(self) -> "_NoisyColumns":
        white, bias, walk, quantum = (self._sizes(item.name) for item in fields(Channel))
        noisy, rounded = np.flatnonzero(white + bias + walk), np.flatnonzero(quantum)
        return _NoisyColumns(noisy, white[noisy], bias[noisy], walk[noisy], rounded, quantum[rounded])

    @property
    def memory_size(self) -> int:
        """Bias plus random walk of each noisy column, if there is a bias or a random walk; then the drawn level."""
        return self._drifting + (self.level is not None)

    @cached_property
    def _drifting(self) -> int:
        columns = self._columns
        return columns.noisy.size if columns.bias.any() or columns.walk.any() else 0

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the biases, and from a stream of its own the level."""
        biases = (self._columns.bias * streams.normal(0, self._columns.noisy.size))[:, : self._drifting]
        if self.level is None:
            return biases
        level = streams.derive(_LEVEL_STREAM).between(0, *self.level)
        return np.hstack([level * biases, level])

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add white noise (block 2 · step + 1 of the random streams) and random walk (2 · step + 2), then round."""
        columns, drift = self._columns, memory[:, : self._drifting]
        level = None if self.level is None else memory[:, -1]
        if columns.noisy.size:
            _add_normal(streams.keys, 2 * step + 1, columns.noisy, columns.white, level, measured.T)
        for i in range(self._drifting):
            measured[:, columns.noisy[i]] += drift[:, i]
        if columns.walk.any():
            every = np.arange(columns.noisy.size)
            _add_normal(streams.keys, 2 * step + 2, every, np.sqrt(period) * columns.walk, level, drift.T)
        if self.direction.white or self.direction.bias or self.direction.walk:
            _normalise(measured.T)
        for column, quantum in zip(columns.rounded, columns.quantum, strict=True):
            unit = quantum if level is None else quantum * level
            measured[:, column] = unit * np.rint(measured[:, column] / unit)


class _NoisyColumns(NamedTuple):
    """The columns of the state in which a `Noise` adds errors, and their sizes; those in which it rounds, and steps."""

    noisy: Integers
    white: Floats
    bias: Floats
    walk: Floats
    rounded: Integers
    quantum: Floats


@inlined
def _add_pair(
    keys: Any, index: Any, pairs: int, pair: int, deviation: Any, level: Any, first: Any, second: Any
) -> None:
    for row in range(keys.size):
        a, b = normal_pair(keys[row], index[row] * pairs + pair)
        factor = 1.0 if level is None else level[row]
        first[row] += deviation[0] * factor * a
        second[row] += deviation[1] * factor * b


@compiled
def _add_normal(
    keys: Keys, index: Integers, columns: Integers, deviation: Floats, level: Floats | None, out: Floats
) -> None:
    """Add normal numbers to the rows `columns` of `out`, shape (k, n); `level`, shape (n,), multiplies them.

    Each pair of rows has a loop of its own, because otherwise the loops are not vectorised.
    """
    pairs = (columns.size + 1) // 2
    for pair in range(columns.size // 2):
        first, second = columns[2 * pair], columns[2 * pair + 1]
        _add_pair(keys, index, pairs, pair, deviation[2 * pair : 2 * pair + 2], level, out[first], out[second])
    if columns.size % 2:
        last = np.array([deviation[-1], 0.0])
        _add_pair(keys, index, pairs, pairs - 1, last, level, out[columns[-1]], np.zeros(keys.size))


@compiled
def _normalise(measured: Floats) -> None:
    for row in range(measured.shape[1]):
        x, y, z = measured[DIRECTION, row], measured[DIRECTION + 1, row], measured[DIRECTION + 2, row]
        size = 1.0 / np.sqrt(x * x + y * y + z * z)
        measured[DIRECTION, row] = size * x
        measured[DIRECTION + 1, row] = size * y
        measured[DIRECTION + 2, row] = size * z


def hold_sample(measured: Floats, memory: Floats, step: Integers, held: Any, ageing: float) -> None:
    """Replace the measurements of the rows `held`, a mask, by the last ones in `memory`, with `ageing` (s) more.

    The first measurement of an episode is never replaced.
    """
    memory[:, AGE] += ageing
    hold(measured, memory, np.where(step > 0, held, False))


@SENSORS.add
@settings
class Delay(ZeroInitialized):
    """A delay of `steps` control steps. During the first `steps` steps of an episode its first sample is repeated."""

    steps: Annotated[int, Range(1, 1000)] = 1  # delay in control steps
    kind: Literal["delay"] = "delay"

    @property
    def memory_size(self) -> int:
        """One measurement for each delayed step."""
        return self.steps * MEASURED_SIZE

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Replace the sample by that of `steps` steps ago."""
        delay(measured, step, memory, self.steps, repeats_first=True)


@SENSORS.add
@settings
class Dropout(ZeroInitialized):
    """Random loss of samples; the last sample received replaces a lost one. The first of an episode is never lost."""

    probability: Annotated[float, Range(0.0, 1.0)] = 0.1  # probability that a sample is lost
    kind: Literal["dropout"] = "dropout"
    memory_size = MEASURED_SIZE  # the last sample received

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Replace lost samples by the last sample received."""
        hold_sample(measured, memory, step, streams.uniform(step + 1, 1)[:, 0] < self.probability, period)


@SENSORS.add
@settings
class Bursts(Interruptions):
    """Drop-outs in bursts: no sample arrives for a time. The last one received replaces them, and its age grows.

    The first sample of an episode is never lost.
    """

    kind: Literal["bursts"] = "bursts"
    memory_size = Interruptions.memory_size + MEASURED_SIZE  # the last sample

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Replace the measurement by the last one before the interruption."""
        hold_sample(measured, memory[:, 2:-1], step, self._held(memory, step, period, streams), period)


@SENSORS.add
@settings
class Frozen(Interruptions):
    """A sensor that gives its last sample, or parts of it, as new for a time: the age of the sample does not grow.

    The first sample of an episode is never replaced.
    """

    length: Annotated[Interval, Range(0.001, 1e6, "s")] = (0.05, 0.05)  # as that of `Bursts`
    pause: Annotated[Interval, Range(0.0, 1e6, "s")] = (1.0, 2.0)  # as that of `Bursts`
    parts: tuple[Part, ...] = tuple(PARTS)  # what is repeated, each part with its rates
    kind: Literal["frozen"] = "frozen"
    memory_size = Interruptions.memory_size + MEASURED_SIZE  # the last sample

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError(f"parts must have one or more of {', '.join(map(repr, PARTS))}")

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Replace the parts of the measurement by the last ones before the interruption."""
        held, last = self._held(memory, step, period, streams), memory[:, 2:-1]
        fresh = [columns for part, columns in PARTS.items() if part not in self.parts]
        for columns in [*fresh, slice(AGE, MEASURED_SIZE)] if fresh else []:
            last[:, columns] = measured[:, columns]
        hold_sample(measured, last, step, held, 0.0)


def _turned(r: Floats, error: Floats) -> Floats:
    """Return unit vectors, shape (n, 3), turned towards the error vectors by their lengths (rad)."""
    side = error - np.sum(error * r, axis=1, keepdims=True) * r
    angle, size = (np.sqrt(np.sum(item * item, axis=1, keepdims=True)) for item in (error, side))
    return np.asarray(np.cos(angle) * r + np.sin(angle) / np.maximum(size, 1e-12) * side)


@SENSORS.add
@settings
class Outliers(Events):
    """Single samples of a part of the state that are wrong, each by a vector of random direction.

    The vector is added to the position or to φ, θ and ψ; the pole is turned towards it, by π to the opposite direction.
    """

    # size of the error (attitude and pole: rad); of two numbers, uniform in this interval and drawn for each outlier
    distance: Annotated[float | Interval, Range(0.0, 1e6, "m")] = 1.0
    # time before each outlier, uniform in this interval, at least 0.001; a control period has at most one outlier
    pause: Annotated[Interval, Range(0.001, 1e6, "s")] = (2.0, 2.0)
    part: Part = "position"  # what is wrong
    kind: Literal["outliers"] = "outliers"
    memory_size = 6  # of `core.events` with a length of 0, around the error (m)

    def _draw_next(self, memory: Floats, ended: Any, streams: Streams) -> None:
        distance = tuple(np.broadcast_to(self.distance, 2))
        bounds = self.pause, (0.0, 0.0), distance, (-1.0, 1.0), (-np.pi, np.pi)
        size, sine, heading = next_events(memory, ended, streams, *bounds)
        flat = size * np.sqrt(1.0 - sine * sine)
        memory[ended, 2:5] = np.stack([flat * np.cos(heading), flat * np.sin(heading), size * sine], axis=1)

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the error of an outlier whose time has come."""
        error = take_due(memory, (step + 0.5) * period, streams, self._draw_next, 0.0)
        first = PARTS[self.part].start
        wrong = measured[:, first : first + 3]
        wrong[:] = _turned(wrong, error) if self.part == "pole" else wrong + error


@SENSORS.add
@settings
class SampleHold(ZeroInitialized):
    """A sensor that is slower than the control loop: it measures every `period` seconds, and its last sample is held.

    The first sample is that of the reset. A sensor whose period divides the control period has a new sample at every
    control step, so it changes nothing.
    """

    period: Annotated[float, Range(1e-6, 1e6, "s")] = 0.02  # time from one sample to the next
    kind: Literal["sample_hold"] = "sample_hold"
    memory_size = MEASURED_SIZE  # the last sample

    def steps(self, control_period: float) -> int:
        """Return the number of control steps from one sample to the next; `control_period` in s."""
        ratio = self.period / control_period
        whole = max(ratio, 1.0 / ratio)
        if abs(whole - round(whole)) > 1e-9 * whole:
            raise ValueError(
                f"period of a SampleHold must be a whole multiple of the control period of {control_period:g} s or"
                f" divide it, not {self.period:g} s"
            )
        return max(round(ratio), 1)

    def sense(self, measured: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Replace the measurement by the last sample."""
        hold_sample(measured, memory, step, step % self.steps(period) != 0, period)


def check_periods(models: tuple[Any, ...], control_period: float) -> None:
    """Refuse sensors without samples at the times of control steps; `control_period` in s."""
    for model in models:
        if isinstance(model, SampleHold):
            model.steps(control_period)
