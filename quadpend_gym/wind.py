"""Disturbance models: batched, seeded by episode, and added with ``+``.

A model says what acts on each sub-environment over the coming control period, as nine numbers in SI units:

| symbol | name      | columns | unit | frame                   |
|--------|-----------|---------|------|-------------------------|
| d_Q    | force     | 0–2     | N    | world, on the quadrotor |
| d_B    | bob_force | 3–5     | N    | world, on the bob       |
| d_τ    | torque    | 6–8     | N·m  | φ, θ, ψ axes            |

Models are frozen data with two functions, so a model of your own needs no base class: see `Wind`. As plain data a model
is a mapping with its ``kind``, which is how it travels in an environment's JSON specification.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from quadpend_gym.arrays import Floats, Integers
from quadpend_gym.records import build, number, positive, vector
from quadpend_gym.streams import Streams

DISTURBANCE_SIZE = 9
Load = float | tuple[float, ...]  # one number for all three axes, or three


@runtime_checkable
class Wind(Protocol):
    """What a disturbance model must be able to do, for a batch of n rows."""

    @property
    def memory_size(self) -> int:
        """How many numbers a row has to remember."""

    def start(self, streams: Streams) -> Floats:
        """Memory of new episodes, shape (n, memory_size), drawn from block 0 of the rows' streams."""

    def blow(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add what acts over the coming control period to `out`.

        Args:
            out: shape (n, 9).
            memory: shape (n, memory_size), updated in place.
            step: control steps since each row's episode began, shape (n,).
            period: of a control step, s.
            streams: the rows' random streams; block `step + 1` belongs to this step.
        """


@dataclass(frozen=True)
class _Loads:
    """A load for each of the nine axes; the fields that most models begin with.

    Raises:
        TypeError: a value is not a number, or a load neither a number nor three numbers.
        ValueError: a value is not finite, or out of its range.
    """

    force: Load = 0.0  # N, on the quadrotor
    bob_force: Load = 0.0  # N, on the bob
    torque: Load = 0.0  # N·m

    def __post_init__(self) -> None:
        for name in ("force", "bob_force", "torque"):
            value = getattr(self, name)
            object.__setattr__(self, name, value if np.isscalar(value) else vector(value, 3, name))
        _ = self.load

    @cached_property
    def load(self) -> Floats:
        """The nine loads, shape (9,)."""
        parts = {"force": self.force, "bob_force": self.bob_force, "torque": self.torque}
        return np.concatenate([vector(value, 3, name) for name, value in parts.items()])

    @cached_property
    def axes(self) -> Sequence[int]:
        """The axes whose load is not zero."""
        return [int(axis) for axis in np.flatnonzero(self.load)]

    @property
    def memory_size(self) -> int:
        """One number for each loaded axis."""
        return len(self.axes)

    def __add__(self, other: Any) -> "Sum":
        return Sum((self, other))


@dataclass(frozen=True)
class Constant(_Loads):
    """A steady disturbance."""

    kind: str = field(default="constant", init=False)

    @property
    def memory_size(self) -> int:
        """Nothing to remember."""
        return 0

    def start(self, streams: Streams) -> Floats:
        """No memory."""
        return np.empty((streams.keys.size, 0))

    def blow(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The loads, always."""
        for axis in self.axes:
            out[:, axis] += self.load[axis]


@dataclass(frozen=True)
class Sinusoid(_Loads):
    """load · sin(frequency · t + phase), with the phase of each axis drawn for each episode."""

    frequency: float = 1.0  # rad/s
    kind: str = field(default="sinusoid", init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self.frequency, "frequency")

    def start(self, streams: Streams) -> Floats:
        """Phases, uniform in (0, 2π)."""
        return 2.0 * np.pi * streams.uniform(np.zeros(streams.keys.size, np.int64), len(self.axes))

    def blow(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The sinusoid in the middle of the period, over which it is held."""
        angle = self.frequency * period * (step + 0.5)
        for column, axis in enumerate(self.axes):
            out[:, axis] += self.load[axis] * np.sin(angle + memory[:, column])


@dataclass(frozen=True)
class OrnsteinUhlenbeck(_Loads):
    """Coloured noise: Gaussian, stationary, with exponentially decaying correlation, independent in each axis.

    The loads are standard deviations σ. Exact discretisation: d_{k+1} = a d_k + σ √(1 − a²) n_k with
    a = exp(−period / time_constant).
    """

    force: Load = 0.3  # N, on the quadrotor
    time_constant: float = 1.0  # s
    kind: str = field(default="ornstein_uhlenbeck", init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self.time_constant, "time_constant")

    def start(self, streams: Streams) -> Floats:
        """The stationary distribution."""
        return self.load[self.axes] * streams.normal(np.zeros(streams.keys.size, np.int64), len(self.axes))

    def blow(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The remembered disturbance; then it decays and is stirred."""
        decay = np.exp(-period / self.time_constant)
        stir = np.sqrt(1.0 - decay**2)
        noise = streams.normal(step + 1, len(self.axes))
        for column, axis in enumerate(self.axes):
            present = memory[:, column]
            out[:, axis] += present
            present *= decay
            present += stir * self.load[axis] * noise[:, column]


@dataclass(frozen=True)
class PaperGusts:
    """The paper's random gusts in x, y, z and yaw, calm until the onset (its Section 5).

    With the paper's onset of 10 s they never blow in an episode of 10 s: lower the onset, or raise the environment's
    `max_episode_steps`. The paper gives neither shape nor size. Here a new target is drawn every `hold` seconds,
    uniform in ± the amplitude, and approached along half a cosine: bounded and differentiable, as the paper's Theorem 1
    assumes.

    Raises:
        TypeError: a value is not a number, or the force neither a number nor three numbers.
        ValueError: a value is not finite, or out of its range.
    """

    force: Load = 0.3  # N, amplitude on the quadrotor
    yaw_torque: float = 0.05  # N·m, amplitude
    onset: float = 10.0  # s
    hold: float = 1.0  # s
    kind: str = field(default="paper_gusts", init=False)

    def __post_init__(self) -> None:
        _ = self.amplitude
        number(self.onset, "onset", 0.0)
        positive(self.hold, "hold")

    @cached_property
    def amplitude(self) -> Floats:
        """Largest force in x, y, z (N) and yaw torque (N·m), shape (4,)."""
        return np.array([*vector(self.force, 3, "force"), number(self.yaw_torque, "yaw_torque")])

    def __add__(self, other: Any) -> "Sum":
        return Sum((self, other))

    @property
    def memory_size(self) -> int:
        """Nothing to remember: the targets are read from the stream by number."""
        return 0

    def start(self, streams: Streams) -> Floats:
        """No memory."""
        return np.empty((streams.keys.size, 0))

    def _target(self, gust: Integers, streams: Streams) -> Floats:
        drawn = 2.0 * streams.uniform(gust, 4) - 1.0
        return np.where(gust[:, np.newaxis] > 0, self.amplitude * drawn, 0.0)

    def blow(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The gust in the middle of the period, over which it is held."""
        phase = np.maximum((step + 0.5) * period - self.onset, 0.0) / self.hold
        gust = np.floor(phase).astype(np.int64)
        blend = 0.5 - 0.5 * np.cos(np.pi * (phase - gust))[:, np.newaxis]
        strength = (1.0 - blend) * self._target(gust, streams) + blend * self._target(gust + 1, streams)
        for column, axis in enumerate((0, 1, 2, 8)):
            out[:, axis] += strength[:, column]


@dataclass(frozen=True)
class Sum:
    """Several models at once.

    Each has a random stream of its own, by its place in the sum: adding one behind leaves the others' numbers alone.

    Args:
        models: models, sums, or mappings with their kinds.

    Raises:
        TypeError: a member is none of these.
        ValueError: a mapping has an unknown kind or setting.
    """

    models: tuple[Any, ...] = ()
    kind: str = field(default="sum", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "models", tuple(m for model in self.models for m in _members(model)))

    def __add__(self, other: Any) -> "Sum":
        return Sum((self, other))


KINDS: dict[str, type[Any]] = {
    "constant": Constant,
    "sinusoid": Sinusoid,
    "ornstein_uhlenbeck": OrnsteinUhlenbeck,
    "paper_gusts": PaperGusts,
    "sum": Sum,
}


def _members(value: Any) -> tuple[Any, ...]:
    if isinstance(value, Mapping):
        data = dict(value)
        kind = data.pop("kind", None)
        if kind not in KINDS:
            raise ValueError(f"wind has no kind {kind!r}; the kinds are {', '.join(KINDS)}")
        value = build(KINDS[kind], data, "wind")
    if isinstance(value, Sum):
        return value.models
    if isinstance(value, Wind) and not isinstance(value, type):
        return (value,)
    raise TypeError(f"wind must be a wind model or a mapping with its kind, not {value!r}")


def as_wind(value: Any) -> Sum:
    """The disturbance that `value` is or describes as a mapping; None is calm.

    Raises:
        TypeError: it is neither a model nor a mapping.
        ValueError: no model is of that kind, or a setting is unknown or out of range.
    """
    return Sum() if value is None else Sum((value,))


class WindProcess:
    """Models at work on a batch of rows.

    Args:
        models: the models that blow together.
        rows: number of rows.
    """

    def __init__(self, models: tuple[Wind, ...], rows: int) -> None:
        """Allocate the memories; every row must `begin` before `blow`."""
        self.models = models
        self._memories = [np.zeros((model.memory_size, rows)).T for model in models]
        self._streams = [Streams(np.zeros(rows, np.uint64)) for _ in models]

    def begin(self, rows: Integers, streams: Streams, period: float) -> Floats:
        """Begin new episodes in `rows`, with one random stream for each; what acts first, shape (m, 9)."""
        out = np.zeros((rows.size, DISTURBANCE_SIZE))
        step = np.zeros(rows.size, np.int64)
        for i, model in enumerate(self.models):
            random = streams.derive(i)
            memory = model.start(random)
            model.blow(out, memory, step, period, random)
            self._memories[i][rows] = memory
            self._streams[i].keys[rows] = random.keys
        return out

    def blow(self, step: Integers, period: float) -> Floats:
        """What acts over the coming control period, shape (n, 9); `step` counts from each episode's beginning."""
        out = np.zeros((step.size, DISTURBANCE_SIZE))
        for model, memory, streams in zip(self.models, self._memories, self._streams, strict=True):
            model.blow(out, memory, step, period, streams)
        return out
