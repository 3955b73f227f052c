"""Domain randomization: physical parameters drawn for each episode."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.ranges import Range, check_fields
from quadpend_gym.core.streams import Streams
from quadpend_gym.core.validation import check_interval, from_plain, suggest, to_plain_fields
from quadpend_gym.physics.parameters import PARAMETER_NAMES, Parameters

Interval = tuple[float, float] | None  # (lowest, highest) of a uniform distribution, or None for the nominal value


@dataclass(frozen=True)
class ParameterRanges:
    """Intervals of the parameters of an episode, with the names and units of `Parameters`.

    Actions are scaled with the nominal parameters: a heavier quadrotor sinks at zero action.

    Raises:
        TypeError: If a value is not a pair of numbers.
        ValueError: If an interval is out of order, contains impossible values, or all values are None.
    """

    quadrotor_mass: Interval = None  # kg
    bob_mass: Interval = None  # kg
    rod_length: Interval = None  # m
    gravity: Interval = None  # m/s²
    inertia_roll: Interval = None  # kg·m²
    inertia_pitch: Interval = None  # kg·m²
    inertia_yaw: Interval = None  # kg·m²
    quadrotor_drag_area: Interval = None  # m²
    bob_drag_area: Interval = None  # m²

    def __post_init__(self) -> None:
        to_plain_fields(self)
        for item in fields(self):
            if (value := getattr(self, item.name)) is not None:
                check_interval(value, item.name, 0.0 if item.name.endswith("drag_area") else 1e-10)
        if all(value is None for value in asdict(self).values()):
            raise ValueError(
                f"at least one parameter must have a range; the parameters are {', '.join(PARAMETER_NAMES)}"
            )

    def draw(self, nominal: Parameters, streams: Streams) -> Floats:
        """Draw the parameters of new episodes, shape (n, 9).

        Each parameter uses its own number of the random stream, so the interval of one parameter does not change the
        values of the others.

        Args:
            nominal: Values of the parameters without an interval.
            streams: Random streams of the n sub-environments.
        """
        return streams.between(0, *_bounds(self, nominal))


@lru_cache(maxsize=64)
def _bounds(ranges: ParameterRanges, nominal: Parameters) -> tuple[Floats, Floats]:
    pairs = [getattr(ranges, name) or (getattr(nominal, name),) * 2 for name in PARAMETER_NAMES]
    lowest, highest = np.array(pairs).T
    return lowest, highest


@dataclass(frozen=True)
class Around:
    """Intervals of ± `share` around the nominal parameters of an environment.

    Raises:
        TypeError: If `share` is not a number, or `names` not a sequence.
        ValueError: If `share` is outside [0, 0.999], or a name is not that of a parameter.
    """

    share: Annotated[float, Range(0.0, 0.999)]  # half width of the interval, as a fraction of the nominal value
    names: tuple[str, ...] = ()  # parameters to randomize; if empty, all but gravity

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_fields(self)
        if not isinstance(self.names, tuple):
            raise TypeError(f"names must be a sequence of names of parameters, not {self.names!r}")
        for name in self.names:
            if name not in PARAMETER_NAMES:
                raise ValueError(
                    f"there is no parameter {name!r}{suggest(name, PARAMETER_NAMES)}; there are"
                    f" {', '.join(PARAMETER_NAMES)}"
                )

    def ranges(self, parameters: Parameters) -> ParameterRanges:
        """Return the intervals around these nominal parameters."""
        names = self.names or tuple(name for name in PARAMETER_NAMES if name != "gravity")
        values = {name: getattr(parameters, name) for name in names}
        pairs = {name: ((1.0 - self.share) * value, (1.0 + self.share) * value) for name, value in values.items()}
        return ParameterRanges(**pairs)


def as_ranges(value: Any) -> ParameterRanges | Around:
    """Convert `value` to parameter ranges.

    Args:
        value: Parameter ranges, a mapping with a ``share``, or a mapping from names of parameters to pairs.

    Raises:
        TypeError: If `value` is none of these.
        ValueError: If a key is unknown or a value is out of range.
    """
    if isinstance(value, Around) or (isinstance(value, Mapping) and "share" in value):
        return from_plain(Around, value, "ranges")
    return from_plain(ParameterRanges, value, "ranges")
