"""The interface of wind models, and the base classes of most models.

A wind model computes forces, a torque and a wind velocity for each sub-environment during the next control period:
twelve components in SI units.

| symbol | name      | columns | unit | frame        | acts on                                        |
|--------|-----------|---------|------|--------------|------------------------------------------------|
| d_Q    | force     | 0–2     | N    | world        | quadrotor                                      |
| d_B    | bob_force | 3–5     | N    | world        | bob                                            |
| d_τ    | torque    | 6–8     | N·m  | see below    | attitude of the quadrotor                      |
| v      | velocity  | 9–11    | m/s  | world        | both, by drag, see `quadpend_gym.physics.drag` |

The velocities of several models are added before the drag is computed from their sum. The torque on a rigid vehicle is
in the world frame, that on the paper's vehicle about the axes of φ, θ and ψ, see `quadpend_gym.physics.state`.

A hand that pulls at the pole's upper end has four more columns, see `quadpend_gym.wind.hand`:

| symbol | name | columns | unit              | frame | acts on                                                       |
|--------|------|---------|-------------------|-------|---------------------------------------------------------------|
| k x, k | hand | 12–14   | N (two), N/m      | world | pole's upper end, horizontally: k (x − its position), and     |
| c      |      | 15      | N·s/m             |       | −c times its velocity                                         |

Force and stiffness of several hands are added like those of several springs.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.jit import compiled
from quadpend_gym.core.models import FromFactory, Model, Parts, Registry
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.core.streams import Streams

__all__ = ["HAND", "SAMPLE_SIZE", "WIND_FIELDS", "WIND_SIZE", "Sum", "Wind", "WindField", "WindFromFactory"]

WIND_SIZE = 12
WIND_FIELDS = {
    "force": slice(0, 3),
    "bob_force": slice(3, 6),
    "torque": slice(6, 9),
    "velocity": slice(9, 12),
}
HAND, SAMPLE_SIZE = slice(12, 16), 16
# First columns of the vectors that a heading rotates; not the torque, which on the paper's vehicle is no world vector.
WORLD_VECTORS = tuple(WIND_FIELDS[name].start for name in ("force", "bob_force", "velocity"))
Load = float | tuple[float, float, float]  # one number for all three axes, or three numbers
LARGEST_LOAD = 1e12  # N or N·m: far more than any wind, so that tests can end an episode at once


@runtime_checkable
class Wind(Model, Protocol):
    """The interface of a wind model, for a batch of n sub-environments. A base class is not needed."""

    @property
    def moves_air(self) -> bool:
        """Whether the model can set a wind velocity. Drag is computed only if this is True for at least one model."""

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the disturbance and wind velocity of the next control period to `out`.

        `out`, shape (n, 12), or (n, 16) if there are hands, is the sum of the models so far. It and the memory, shape
        (n, memory_size), have contiguous columns. `step` counts the control steps of each episode, shape (n,), with the
        duration `period` (s). Of the random streams of the n sub-environments, this step may use block `step + 1`.
        """


def can_hold(models: Iterable[Any]) -> bool:
    """Return whether a model can set the columns of a hand: one with a true attribute `holds`."""
    return any(getattr(model, "holds", False) for model in models)


class Addable:
    """Mixin that adds models with ``+`` and `sum`."""

    def __add__(self, other: Any) -> "Sum":
        return Sum((self, other))

    def __radd__(self, other: Any) -> "Sum":
        return Sum((self,) if isinstance(other, int) and other == 0 else (other, self))


class Composite(Parts, Addable):
    """Base class of winds that consist of other models, by default those of their field `wind`."""

    wind: Any

    @property
    def parts(self) -> Any:
        """The models."""
        return self.wind.models

    @property
    def moves_air(self) -> bool:
        """Whether the wind can set a wind velocity."""
        return any(model.moves_air for model in self.parts)

    @cached_property
    def holds(self) -> bool:
        """Whether the wind can set the columns of a hand."""
        return can_hold(self.parts)

    def _sampled(self, memory: Floats, step: Integers, period: float, streams: Streams) -> Floats:
        """Return the winds of its models, shape (n, 12), or (n, 16) if they can set the columns of a hand."""
        wind = np.zeros((SAMPLE_SIZE if self.holds else WIND_SIZE, step.size)).T
        self._add(wind, memory, step, period, streams)
        return wind

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the winds of its models."""
        self._add(out, memory, step, period, streams)

    def _add(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        self.each(memory, streams, lambda model, own, random: model.sample(out, own, step, period, random))


@settings
class WindFromFactory(FromFactory, Composite):
    """The wind that a function or class of the user's own code returns."""

    @cached_property
    def parts(self) -> Any:
        """The models that the factory returns."""
        return WINDS.make(self.kind)


WINDS = Registry("wind", Wind, WindFromFactory)


@WINDS.add
@settings
class Sum(Addable):
    """Sum of several models.

    Each model has its own random stream, numbered by its position in the sum, so appending a model does not change the
    numbers of the others.
    """

    models: Annotated[Any, WINDS.field()] = ()  # models, sums, names of presets or kinds, or mappings with their kind
    kind: Literal["sum"] = "sum"


WindField = WINDS.field(lambda value: Sum(WINDS.parse(value)))  # annotation of a field that holds a wind as a `Sum`


@settings
class Loads(Addable):
    """Base class of models with a fixed magnitude, the load, in each of the twelve columns."""

    force: Annotated[Load, Range(-LARGEST_LOAD, LARGEST_LOAD, "N")] = 0.0  # force on the quadrotor
    bob_force: Annotated[Load, Range(-LARGEST_LOAD, LARGEST_LOAD, "N")] = 0.0  # force on the bob
    torque: Annotated[Load, Range(-LARGEST_LOAD, LARGEST_LOAD, "N·m")] = 0.0  # torque on the quadrotor
    velocity: Annotated[Load, Range(-1e4, 1e4, "m/s")] = 0.0  # velocity of the air

    @cached_property
    def load(self) -> Floats:
        """The twelve loads, shape (12,)."""
        return np.concatenate([np.broadcast_to(getattr(self, name), 3) for name in WIND_FIELDS])

    @cached_property
    def axes(self) -> Sequence[int]:
        """Columns with a non-zero load."""
        return [int(axis) for axis in np.flatnonzero(self.load)]

    @cached_property
    def moves_air(self) -> bool:
        """Whether the load contains a non-zero wind velocity."""
        return bool(self.load[WIND_FIELDS["velocity"]].any())


@compiled
def add_rotated(out: Floats, axis: int, vector: Any, factor: Floats, cosine: Floats, sine: Floats) -> None:
    """Rotate factor · vector about the vertical, from x towards y, and add it to the columns of `out` from `axis`.

    The components of the vector are numbers or arrays of shape (n,); factor, cosine and sine have the shape (n,).
    """
    x, y, z = vector[0], vector[1], vector[2]
    out[:, axis] += factor * (cosine * x - sine * y)
    out[:, axis + 1] += factor * (sine * x + cosine * y)
    out[:, axis + 2] += factor * z
