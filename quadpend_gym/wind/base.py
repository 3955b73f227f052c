"""What a wind model is, and the fields that most of them begin with.

A model says what acts on each row over the coming control period, as twelve numbers in SI units, world frame:

| symbol | name      | columns | unit | acts on                                                      |
|--------|-----------|---------|------|--------------------------------------------------------------|
| d_Q    | force     | 0–2     | N    | quadrotor                                                    |
| d_B    | bob_force | 3–5     | N    | bob                                                          |
| d_τ    | torque    | 6–8     | N·m  | φ, θ, ψ                                                      |
| v      | velocity  | 9–11    | m/s  | both, through the drag on the relative air speed, see `drag` |

Velocities of several models add up before the drag is taken of their sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.models import Model, Registry
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import as_vector, to_plain_fields

WIND_SIZE = 12
WIND_FIELDS = {
    "force": slice(0, 3),
    "bob_force": slice(3, 6),
    "torque": slice(6, 9),
    "velocity": slice(9, 12),
}
TURNED = tuple(WIND_FIELDS[name].start for name in ("force", "bob_force", "velocity"))  # what a heading turns
Load = float | tuple[float, ...]  # one number for all three axes, or three


@runtime_checkable
class Wind(Model, Protocol):
    """What a wind model must be able to do, for a batch of n rows. No base class is needed."""

    @property
    def moves_air(self) -> bool:
        """Whether it ever has velocities. Without such a model there is no air, and so no drag: the paper's calm."""

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add what acts over the coming control period to `out`.

        Args:
            out: shape (n, 12), columns contiguous.
            memory: shape (n, memory_size), columns contiguous, updated in place.
            step: control steps since each row's episode began, shape (n,).
            period: of a control step, s.
            streams: the rows' random streams; block `step + 1` belongs to this step.
        """


WINDS = Registry("wind", "a wind model, the name of a wind", Wind)  # `registry` adds the kinds and presets


class Addable:
    """The part of a model that lets it be added to others with ``+`` and `sum`."""

    def __add__(self, other: Any) -> "Sum":
        return Sum((self, other))

    def __radd__(self, other: Any) -> "Sum":
        return Sum((self,) if isinstance(other, int) and other == 0 else (other, self))


@dataclass(frozen=True)
class Loads(Addable):
    """A load for each of the twelve columns; the fields that most models begin with.

    Raises:
        TypeError: a value is not a number, or a load neither a number nor three numbers.
        ValueError: a value is not finite, or out of its range.
    """

    force: Load = 0.0  # N, on the quadrotor
    bob_force: Load = 0.0  # N, on the bob
    torque: Load = 0.0  # N·m
    velocity: Load = 0.0  # m/s, of the air

    def __post_init__(self) -> None:
        to_plain_fields(self)
        _ = self.load

    @cached_property
    def load(self) -> Floats:
        """The twelve loads, shape (12,)."""
        return np.concatenate([as_vector(getattr(self, name), 3, name) for name in WIND_FIELDS])

    @cached_property
    def axes(self) -> Sequence[int]:
        """The columns whose load is not zero."""
        return [int(axis) for axis in np.flatnonzero(self.load)]

    @cached_property
    def moves_air(self) -> bool:
        """Whether there is a velocity among the loads."""
        return bool(self.load[WIND_FIELDS["velocity"]].any())


def add_turned(out: Floats, axis: int, vector: Any, factor: Floats, cosine: Floats, sine: Floats) -> None:
    """Add factor · vector, turned about the vertical, to the three columns from `axis` on.

    Args:
        out: shape (n, 12).
        axis: first column.
        vector: x, y and z, each a number or an array of shape (n,).
        factor: shape (n,).
        cosine: of the angle, from x towards y, shape (n,).
        sine: of the angle, shape (n,).
    """
    x, y, z = vector
    out[:, axis] += factor * (cosine * x - sine * y)
    out[:, axis + 1] += factor * (sine * x + cosine * y)
    out[:, axis + 2] += factor * z


@dataclass(frozen=True)
class Sum(Addable):
    """Several models at once.

    Each has a random stream of its own, by its place in the sum: adding one behind leaves the others' numbers alone.

    Args:
        models: models, sums, names of presets, or mappings with their kinds.

    Raises:
        TypeError: a member is none of these.
        ValueError: a mapping has an unknown kind or setting, or a name is unknown.
    """

    models: tuple[Any, ...] = ()
    kind: str = field(default="sum", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "models", WINDS.parse(self.models))
