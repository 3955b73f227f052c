"""Constant, sinusoidal and stepping winds, still air, winds of random strength and heading, scaled and rising winds."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.models import Stateless
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind.base import (
    HAND,
    WIND_FIELDS,
    WINDS,
    WORLD_VECTORS,
    Addable,
    Composite,
    Load,
    Loads,
    Sum,
    WindField,
    add_rotated,
)

__all__ = ["Constant", "Drawn", "Relative", "Rescaled", "Sinusoid", "Step", "StillAir"]


@WINDS.add
@settings
class Constant(Stateless, Loads):
    """A constant disturbance or wind velocity."""

    kind: Literal["constant"] = "constant"

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the loads."""
        for axis in self.axes:
            out[:, axis] += self.load[axis]


@WINDS.add
@settings
class Sinusoid(Loads):
    """A sinusoid, load · sin(frequency · t + phase).

    The phase of each axis is drawn for each episode. Add several models with ``+`` for several frequencies.
    """

    frequency: Annotated[float, Range(1e-6, 1e6, "rad/s")] = 1.0  # angular frequency
    kind: Literal["sinusoid"] = "sinusoid"

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


@WINDS.add
@settings
class Step(Loads):
    """Loads that begin at a time, rise along half a period of a cosine, and stay."""

    # beginning of the rise; of two numbers, uniform in this interval and drawn for each episode
    at: Annotated[float | Interval, Range(0.0, 1e6, "s")] = 3.0
    rise: Annotated[float, Range(1e-6, 1e6, "s")] = 0.1  # duration of the rise
    kind: Literal["step"] = "step"
    memory_size = 1  # beginning of the rise, s

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw the beginning of the rise."""
        return streams.between(0, *np.broadcast_to(self.at, (1, 2)).T)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the value in the middle of the control period, which is constant during the period."""
        phase = np.clip(((step + 0.5) * period - memory[:, 0]) / self.rise, 0.0, 1.0)
        share = 0.5 - 0.5 * np.cos(np.pi * phase)
        for axis in self.axes:
            out[:, axis] += self.load[axis] * share


@WINDS.add
@settings
class StillAir(Stateless, Addable):
    """Air at rest. Without this model, drag is computed only if another model sets a wind velocity."""

    kind: Literal["still_air"] = "still_air"
    moves_air = True

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add nothing."""


@WINDS.add
@settings
class Drawn(Composite):
    """A wind that is scaled by a factor and rotated about the vertical by an angle, both drawn for each episode.

    Forces, velocities and the position of a hand turn; the torque keeps its direction, see `wind.base`. Of a hand,
    stiffness and damping are scaled.
    """

    wind: Annotated[Any, WindField]
    strength: Annotated[Interval, Range(-1000.0, 1000.0)] = (1.0, 1.0)  # factor on the wind, uniform in this interval
    # rotation of the wind from x towards y, uniform in this interval
    heading: Annotated[Interval, Range(-1000.0, 1000.0, "rad")] = (-np.pi, np.pi)
    kind: Literal["drawn"] = "drawn"

    @property
    def memory_size(self) -> int:
        """Strength, cosine and sine of the heading, and the memory of the drawn wind."""
        return 3 + super().memory_size

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw strength and heading, and the initial memory of the drawn wind."""
        strength, heading = streams.between(0, *zip(self.strength, self.heading, strict=True)).T
        return np.column_stack([strength, np.cos(heading), np.sin(heading), super().initial_memory(streams)])

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the drawn wind, scaled and rotated."""
        wind = self._sampled(memory[:, 3:], step, period, streams)
        strength, cosine, sine = memory[:, :3].T
        for axis in WORLD_VECTORS:
            add_rotated(out, axis, wind[:, axis : axis + 3].T, strength, cosine, sine)
        torque = WIND_FIELDS["torque"]  # on the paper's vehicle no world vector, so no heading rotates it
        out[:, torque] += strength[:, np.newaxis] * wind[:, torque]
        if self.holds:  # (k x, k) turns about the vertical through the origin
            add_rotated(out, HAND.start, wind[:, HAND].T, strength, cosine, sine)
            out[:, HAND.stop - 1] += strength * wind[:, HAND.stop - 1]

    def _streams(self, i: int, streams: Streams) -> Streams:
        return streams.derive(i)


@WINDS.add
@settings
class Rescaled(Composite):
    """A wind whose forces and torques are multiplied by factors.

    Its wind velocities do not change, and neither do stiffness and damping of a hand, which are not those of a vehicle.

    A force that suits one vehicle is too strong or too weak for a vehicle of another weight; `scale` is then the ratio
    of the weights, and `torque_scale` that of the torque limits. The drag of a wind velocity follows from the drag
    areas, which belong to the vehicle.
    """

    wind: Annotated[Any, WindField]
    scale: Annotated[float, Range(0.0, 1e4)] = 1.0  # factor on the forces
    # factor on the torques, one or one for each axis; None: `scale`
    torque_scale: Annotated[Load | None, Range(0.0, 1e4)] = None
    kind: Literal["rescaled"] = "rescaled"

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the winds of its models, with scaled forces and torques."""
        wind = self._sampled(memory, step, period, streams)
        factors = {"force": self.scale, "bob_force": self.scale, "torque": self.torque_factors, "velocity": 1.0}
        for name, columns in WIND_FIELDS.items():
            out[:, columns] += np.asarray(factors[name]) * wind[:, columns]
        if self.holds:
            out[:, HAND] += wind[:, HAND]

    @property
    def torque_factors(self) -> tuple[float, ...]:
        """The factors of the torques about x, y and z."""
        return tuple(np.broadcast_to(self.scale if self.torque_scale is None else self.torque_scale, 3).tolist())


@WINDS.add
@settings
class Relative(Composite):
    """A wind, such as a preset, whose forces and torques are those on the paper's vehicle.

    A scenario multiplies them by the ratios of the weights and the torque limits of its vehicle and the paper's.
    """

    wind: Annotated[Any, WindField]
    kind: Literal["relative"] = "relative"


Factors = tuple[float, tuple[float, float, float]]  # of forces, and of the torques about each axis


def rescaled(models: tuple[Any, ...], factors: Factors) -> tuple[Any, ...]:
    """Return wind models whose forces and torques are multiplied by factors."""
    return models if {factors[0], *factors[1]} == {1.0} else tuple(Rescaled(model, *factors) for model in models)


def for_vehicle(models: Iterable[Any], factors: Factors) -> tuple[Any, ...]:
    """Return wind models with those that are `Relative`, at any depth, multiplied by the factors of a vehicle."""
    found: list[Any] = []
    for model in models:
        parts = for_vehicle(model.parts, factors) if isinstance(model, Composite) else ()
        if isinstance(model, Relative):
            found.extend(rescaled(model.parts, factors))
        elif not isinstance(model, Composite) or parts == tuple(model.parts):
            found.append(model)
        else:
            changed: Any = model
            found.append(replace(changed, wind=Sum(parts)) if hasattr(model, "wind") else Rescaled(Sum(parts)))
    return tuple(found)


@settings
class Rising(Composite):
    """A wind that begins with still air: it is multiplied by min(t/rise, 1), see `Scenario.wind_rise`.

    Of a hand, stiffness and damping are multiplied.

    Its random numbers are those of the wind without the rise.
    """

    wind: Annotated[Any, WindField]
    rise: Annotated[float, Range(1e-6, 1e6, "s")]

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the wind, multiplied by the factor in the middle of the control period."""
        wind = self._sampled(memory, step, period, streams)
        out[:, : wind.shape[1]] += np.minimum((step + 0.5) * period / self.rise, 1.0)[:, np.newaxis] * wind
