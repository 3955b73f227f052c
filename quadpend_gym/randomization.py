"""Parameter uncertainty: physical parameters drawn for each episode."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import check_interval, check_number, from_plain, to_plain_fields
from quadpend_gym.physics.parameters import PARAMETER_NAMES, Parameters

Range = tuple[float, float] | None  # (lowest, highest), uniform between; None: the nominal value


@dataclass(frozen=True)
class ParameterRanges:
    """Where each episode's parameters are drawn from, with the names and units of `Parameters`.

    What an action means does not change with them: a heavier quadrotor sinks at zero action.

    Raises:
        TypeError: a value is no pair of numbers.
        ValueError: a range is out of order, a value no parameter can have, or nothing is uncertain.
    """

    quadrotor_mass: Range = None  # kg
    bob_mass: Range = None  # kg
    rod_length: Range = None  # m
    gravity: Range = None  # m/s²
    inertia_roll: Range = None  # kg·m²
    inertia_pitch: Range = None  # kg·m²
    inertia_yaw: Range = None  # kg·m²
    quadrotor_drag_area: Range = None  # m²
    bob_drag_area: Range = None  # m²

    def __post_init__(self) -> None:
        to_plain_fields(self)
        for item in fields(self):
            if (value := getattr(self, item.name)) is not None:
                Parameters(**{item.name: check_interval(value, item.name)[0]})
        if all(value is None for value in asdict(self).values()):
            raise ValueError(
                f"at least one parameter must have a range; the parameters are {', '.join(PARAMETER_NAMES)}"
            )

    def draw(self, nominal: Parameters, streams: Streams) -> Floats:
        """Parameters of new episodes, shape (n, 9).

        Each parameter has a number of the stream of its own: another range leaves the others' values alone.

        Args:
            nominal: has the values that have no range.
            streams: of the rows.
        """
        return streams.between(0, *_bounds(self, nominal))


@lru_cache(maxsize=64)
def _bounds(ranges: ParameterRanges, nominal: Parameters) -> tuple[Floats, Floats]:
    pairs = [getattr(ranges, name) or (getattr(nominal, name),) * 2 for name in PARAMETER_NAMES]
    lowest, highest = np.array(pairs).T
    return lowest, highest


@dataclass(frozen=True)
class Around:
    """Ranges of ± `share` around an environment's own parameters.

    Raises:
        TypeError: `share` is not a number.
        ValueError: it is outside [0, 1), or there is no such parameter.
    """

    share: float  # of the value
    names: tuple[str, ...] = ()  # of the uncertain parameters; without, all but gravity

    def __post_init__(self) -> None:
        to_plain_fields(self)
        if check_number(self.share, "share", 0.0) >= 1.0:
            raise ValueError(f"share must be below 1, not {self.share!r}")
        if not isinstance(self.names, tuple):
            raise TypeError(f"names must be a sequence of names of parameters, not {self.names!r}")
        for name in self.names:
            if name not in PARAMETER_NAMES:
                raise ValueError(f"there is no parameter {name!r}; there are {', '.join(PARAMETER_NAMES)}")

    def ranges(self, parameters: Parameters) -> ParameterRanges:
        """The ranges around these parameters."""
        chosen = self.names or tuple(name for name in PARAMETER_NAMES if name != "gravity")
        values = {name: getattr(parameters, name) for name in chosen}
        pairs = {name: ((1.0 - self.share) * value, (1.0 + self.share) * value) for name, value in values.items()}
        return ParameterRanges(**pairs)


def as_ranges(value: Any) -> ParameterRanges | Around:
    """The ranges that `value` is or describes: a mapping with a share, or from names of parameters to pairs.

    Raises:
        TypeError: it is neither.
        ValueError: something in it is unknown or out of range.
    """
    if isinstance(value, Around) or (isinstance(value, Mapping) and "share" in value):
        return from_plain(Around, value, "ranges")
    return from_plain(ParameterRanges, value, "ranges")
