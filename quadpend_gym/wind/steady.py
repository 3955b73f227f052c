"""Winds that one could write down: constant, sinusoidal, and any model with strength and heading drawn."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.models import Stateless
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import check_interval, check_positive, to_plain_fields
from quadpend_gym.wind.base import TURNED, WIND_FIELDS, WIND_SIZE, Addable, Loads, Sum, add_turned


@dataclass(frozen=True)
class Constant(Stateless, Loads):
    """A steady disturbance."""

    kind: str = field(default="constant", init=False)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The loads, always."""
        for axis in self.axes:
            out[:, axis] += self.load[axis]


@dataclass(frozen=True)
class Sinusoid(Loads):
    """load · sin(frequency · t + phase), with the phase of each axis drawn for each episode; add several with ``+``."""

    frequency: float = 1.0  # rad/s
    kind: str = field(default="sinusoid", init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self.frequency, "frequency")

    @property
    def memory_size(self) -> int:
        """A phase for each loaded axis."""
        return len(self.axes)

    def initial_memory(self, streams: Streams) -> Floats:
        """Phases, uniform in (0, 2π)."""
        return 2.0 * np.pi * streams.uniform(0, len(self.axes))

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The sinusoid in the middle of the period, over which it is held."""
        angle = self.frequency * period * (step + 0.5)
        for column, axis in enumerate(self.axes):
            out[:, axis] += self.load[axis] * np.sin(angle + memory[:, column])


@dataclass(frozen=True)
class StillAir(Stateless, Addable):
    """Air that does not move, but brakes what moves. Without it, or a wind with a velocity, there is no drag."""

    kind: str = field(default="still_air", init=False)

    @property
    def moves_air(self) -> bool:
        """There is air."""
        return True

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Nothing."""


@dataclass(frozen=True)
class Drawn(Addable):
    """Another wind, stronger or weaker and turned about the vertical, by a factor and an angle drawn for each episode.

    Raises:
        TypeError: `wind` is no wind, or a range no pair of numbers.
        ValueError: a range is not finite or out of order.
    """

    wind: Any  # a model, a sum of them, the name of a preset or a mapping with its kind
    strength: tuple[float, float] = (1.0, 1.0)  # factor, uniform between the two
    heading: tuple[float, float] = (-np.pi, np.pi)  # rad, from x towards y, uniform between the two
    kind: str = field(default="drawn", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        object.__setattr__(self, "wind", Sum(self.wind))
        for name in ("strength", "heading"):
            check_interval(getattr(self, name), name)

    @property
    def moves_air(self) -> bool:
        """As the wind."""
        return any(model.moves_air for model in self.wind.models)

    @property
    def memory_size(self) -> int:
        """Strength, cosine and sine of the heading, and what the wind remembers."""
        return 3 + sum(self._sizes)

    @cached_property
    def _sizes(self) -> Sequence[int]:
        return [model.memory_size for model in self.wind.models]

    def initial_memory(self, streams: Streams) -> Floats:
        """Strength and heading, uniform in their ranges, and what the wind starts with."""
        strength, heading = streams.between(0, *zip(self.strength, self.heading, strict=True)).T
        below = [model.initial_memory(streams.derive(i)) for i, model in enumerate(self.wind.models)]
        return np.column_stack([strength, np.cos(heading), np.sin(heading), *below])

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """The wind, turned and scaled."""
        air = np.zeros((WIND_SIZE, step.size)).T
        first = 3
        for i, (model, size) in enumerate(zip(self.wind.models, self._sizes, strict=True)):
            model.sample(air, memory[:, first : first + size], step, period, streams.derive(i))
            first += size
        strength, cosine, sine = memory[:, :3].T
        for axis in TURNED:
            add_turned(out, axis, air[:, axis : axis + 3].T, strength, cosine, sine)
        torque = WIND_FIELDS["torque"]  # about the body's axes, which a heading does not turn
        out[:, torque] += strength[:, np.newaxis] * air[:, torque]
