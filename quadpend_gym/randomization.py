"""Parameter uncertainty: physical parameters drawn for each episode."""

from dataclasses import asdict, dataclass, fields

import numpy as np

from quadpend_gym.arrays import Floats
from quadpend_gym.params import PAPER, PARAMETER_NAMES, Parameters
from quadpend_gym.records import interval, number
from quadpend_gym.streams import Streams

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
        for item in fields(self):
            if (value := getattr(self, item.name)) is not None:
                pair = interval(value, item.name)
                object.__setattr__(self, item.name, pair)
                Parameters(**{item.name: pair[0]})
        if all(value is None for value in asdict(self).values()):
            raise ValueError(
                f"at least one parameter must have a range; the parameters are {', '.join(PARAMETER_NAMES)}"
            )

    @classmethod
    def around(cls, share: float, *names: str, parameters: Parameters = PAPER) -> "ParameterRanges":
        """Ranges of ± `share` around the values of some parameters, or of all but gravity.

        Raises:
            TypeError: `share` is not a number.
            ValueError: it is outside [0, 1), or there is no such parameter.
        """
        if number(share, "share", 0.0) >= 1.0:
            raise ValueError(f"share must be below 1, not {share!r}")
        for name in names:
            if name not in PARAMETER_NAMES:
                raise ValueError(f"there is no parameter {name!r}; there are {', '.join(PARAMETER_NAMES)}")
        chosen = names or tuple(name for name in PARAMETER_NAMES if name != "gravity")
        values = {name: getattr(parameters, name) for name in chosen}
        return cls(**{name: ((1.0 - share) * value, (1.0 + share) * value) for name, value in values.items()})

    def draw(self, nominal: Floats, streams: Streams) -> Floats:
        """Parameters of new episodes, shape (n, 9).

        Each parameter has a number of the stream of its own: another range leaves the others' values alone.

        Args:
            nominal: `Parameters.as_array` of the values that have no range.
            streams: of the rows.
        """
        ranges = [getattr(self, name) or (value, value) for name, value in zip(PARAMETER_NAMES, nominal, strict=True)]
        lowest, highest = np.array(ranges).T
        drawn = streams.uniform(np.zeros(streams.keys.size, np.int64), len(PARAMETER_NAMES))
        return np.asarray(lowest + (highest - lowest) * drawn)
