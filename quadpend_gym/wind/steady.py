"""Constant and sinusoidal winds, still air, winds of random strength and heading, and scaled winds."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.models import Stateless
from quadpend_gym.core.ranges import Range, check_fields
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import as_vector, to_plain_fields
from quadpend_gym.wind.base import (
    WIND_FIELDS,
    WIND_SIZE,
    WORLD_VECTORS,
    Addable,
    Composite,
    Load,
    Loads,
    Sum,
    add_rotated,
)

LARGEST_FACTOR = 1e6  # product of the factors of winds within winds


@dataclass(frozen=True)
class Constant(Stateless, Loads):
    """A constant disturbance or wind velocity."""

    kind: str = field(default="constant", init=False)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the loads."""
        for axis in self.axes:
            out[:, axis] += self.load[axis]


@dataclass(frozen=True)
class Sinusoid(Loads):
    """A sinusoid, load · sin(frequency · t + phase).

    The phase of each axis is drawn for each episode. Add several models with ``+`` for several frequencies.
    """

    frequency: Annotated[float, Range(1e-6, 1e6, "rad/s")] = 1.0
    kind: str = field(default="sinusoid", init=False)

    @property
    def memory_size(self) -> int:
        """One phase for each axis with a load."""
        return len(self.axes)

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the phases, uniform in (0, 2π)."""
        return 2.0 * np.pi * streams.uniform(0, len(self.axes))

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the value in the middle of the control period, which is constant during the period."""
        angle = self.frequency * period * (step + 0.5)
        for column, axis in enumerate(self.axes):
            out[:, axis] += self.load[axis] * np.sin(angle + memory[:, column])


@dataclass(frozen=True)
class StillAir(Stateless, Addable):
    """Air at rest. Without this model, drag is computed only if another model sets a wind velocity."""

    kind: str = field(default="still_air", init=False)

    @property
    def moves_air(self) -> bool:
        """True, so that drag is computed."""
        return True

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add nothing."""


@dataclass(frozen=True)
class Drawn(Addable):
    """A wind that is scaled by a factor and rotated about the vertical by an angle, both drawn for each episode.

    Raises:
        TypeError: If `wind` is not a wind, or an interval is not a pair of numbers.
        ValueError: If an interval is out of its range or out of order.
    """

    wind: Any  # a model, a sum, the name of a preset or kind, or a mapping with its kind
    strength: Annotated[tuple[float, float], Range(-1000.0, 1000.0)] = (1.0, 1.0)  # factor, uniform in this interval
    # from x towards y, uniform in this interval
    heading: Annotated[tuple[float, float], Range(-1000.0, 1000.0, "rad")] = (-np.pi, np.pi)
    kind: str = field(default="drawn", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        object.__setattr__(self, "wind", Sum(self.wind))
        check_fields(self)
        _check_factor(self, "strength")

    @property
    def moves_air(self) -> bool:
        """Whether the drawn wind can set a wind velocity."""
        return any(model.moves_air for model in self.wind.models)

    @property
    def memory_size(self) -> int:
        """Strength, cosine and sine of the heading, and the memory of the drawn wind."""
        return 3 + sum(self._sizes)

    @cached_property
    def _sizes(self) -> Sequence[int]:
        return [model.memory_size for model in self.wind.models]

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw strength and heading, and the initial memory of the drawn wind."""
        strength, heading = streams.between(0, *zip(self.strength, self.heading, strict=True)).T
        memories = [model.initial_memory(streams.derive(i)) for i, model in enumerate(self.wind.models)]
        return np.column_stack([strength, np.cos(heading), np.sin(heading), *memories])

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the drawn wind, scaled and rotated."""
        wind = np.zeros((WIND_SIZE, step.size)).T
        first = 3
        for i, (model, size) in enumerate(zip(self.wind.models, self._sizes, strict=True)):
            model.sample(wind, memory[:, first : first + size], step, period, streams.derive(i))
            first += size
        strength, cosine, sine = memory[:, :3].T
        for axis in WORLD_VECTORS:
            add_rotated(out, axis, wind[:, axis : axis + 3].T, strength, cosine, sine)
        torque = WIND_FIELDS["torque"]  # about the φ, θ and ψ axes, so the heading does not rotate it
        out[:, torque] += strength[:, np.newaxis] * wind[:, torque]


@dataclass(frozen=True)
class Rescaled(Composite):
    """A wind whose forces and torques are multiplied by factors. Its wind velocities do not change.

    A force that suits one vehicle is too strong or too weak for a vehicle of another weight; `scale` is then the ratio
    of the weights, and `torque_scale` that of the torque limits. The drag of a wind velocity follows from the drag
    areas, which belong to the vehicle.

    Raises:
        TypeError: If `wind` is not a wind, `scale` not a number, or `torque_scale` neither a number nor three numbers.
        ValueError: If a factor is outside its range.
    """

    wind: Any  # a model, a sum, the name of a preset or kind, or a mapping with its kind
    scale: Annotated[float, Range(0.0, 1e4)] = 1.0
    # of torques, about all axes or about each; None: `scale`
    torque_scale: Annotated[Load | None, Range(0.0, 1e4)] = None
    kind: str = field(default="rescaled", init=False)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        object.__setattr__(self, "wind", Sum(self.wind))
        check_fields(self)
        _check_factor(self, "torque_scale" if max(self.torque_factors) > self.scale else "scale")

    @property
    def parts(self) -> tuple[Any, ...]:
        """The scaled models."""
        models: tuple[Any, ...] = self.wind.models
        return models

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the winds of its models, with scaled forces and torques."""
        wind = np.zeros((WIND_SIZE, step.size)).T
        super().sample(wind, memory, step, period, streams)
        factors: dict[str, Any] = {"torque": self.torque_factors, "velocity": 1.0}
        for name, columns in WIND_FIELDS.items():
            out[:, columns] += np.asarray(factors.get(name, self.scale)) * wind[:, columns]

    @cached_property
    def torque_factors(self) -> tuple[float, ...]:
        """The factors of the torques about x, y and z."""
        return as_vector(self.scale if self.torque_scale is None else self.torque_scale, 3, "torque_scale")


def _largest_factor(wind: Any) -> float:
    """Return the largest product of the factors of a wind and of winds within it."""
    if isinstance(wind, Drawn):
        own, parts = max(map(abs, wind.strength)), wind.wind.models
    elif isinstance(wind, Rescaled):
        own, parts = max(wind.scale, *wind.torque_factors), wind.parts
    else:
        own, parts = 1.0, getattr(wind, "parts", ())
    return float(own * max(map(_largest_factor, parts), default=1.0))


def _check_factor(wind: Any, name: str) -> None:
    """Refuse factors of winds within winds whose product is larger than `LARGEST_FACTOR`."""
    factor = _largest_factor(wind)
    if factor > LARGEST_FACTOR:
        raise ValueError(
            f"{name} and the factors of the winds within the wind must multiply to at most {LARGEST_FACTOR:g}, not"
            f" {factor:g}"
        )
