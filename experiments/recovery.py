"""Recovery maps: the starts from which a policy returns to hover in calm air (its region of attraction).

An episode has settled if its error is below 5 cm during the last second; the settling time is the time after which the
error stays below. An episode recovers if it settles. A grid is symmetric about hover. It sets two quantities of the
start; all others are those of hover, and nothing is random. `experiments.robustness` draws the maps, and
`experiments.vehicles` and `experiments.tasks` use the settling times.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.task import TASKS
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.recovery import settling_times

HOVER_HEIGHT = 2.0  # m, of the hover point above the origin
CALM, CALM_HOVER = Scenario(), Scenario(TASKS["hover"])


class GridAxis(NamedTuple):
    """One axis of a grid of starts, with ascending values."""

    title: str
    unit: str
    values: Floats


@dataclass(frozen=True)
class StartGrid:
    """A grid of starts: `start` is a function from values on x and y, shapes (n,), to fields of the state.

    The other fields are those of hover.
    """

    title: str
    x: GridAxis
    y: GridAxis
    start: Callable[[Floats, Floats], dict[str, Floats]]

    @property
    def size(self) -> int:
        """Number of starts."""
        return self.x.values.size * self.y.values.size

    def options(self) -> dict[str, Any]:
        """Return the options of `reset` for all starts, line by line from the lowest y, with x varying fastest."""
        x, y = (values.ravel() for values in np.meshgrid(self.x.values, self.y.values))
        hover = {"position": (0.0, 0.0, HOVER_HEIGHT), "direction": (0.0, 0.0, 1.0)}
        rest = dict.fromkeys(("velocity", "euler", "euler_rate", "direction_rate"), (0.0, 0.0, 0.0))
        return {"state": {**rest, **hover, **self.start(x, y)}}


class RecoveryMap(NamedTuple):
    """Whether each start of a grid survives, and the time to recover, s, nan where it does not; shape (s, ny, nx)."""

    survived: Booleans
    time: Floats

    @property
    def recovered(self) -> float:
        """Share of recovered starts over all training seeds, %."""
        return float(100.0 * np.mean(~np.isnan(self.time)))


def recovery_map(results: EpisodeResults, grid: StartGrid, period: float) -> RecoveryMap:
    """Return the map of the episodes of a grid, in the order of `StartGrid.options`."""
    shape = (len(results.survived), grid.y.values.size, grid.x.values.size)
    time = settling_times(results.survived, results.error, period)
    return RecoveryMap(results.survived.reshape(shape), time.reshape(shape))


def largest_recovered(found: RecoveryMap, values: Floats) -> float:
    """Return the largest of ascending values such that a policy recovers from all up to it; nan if there is none."""
    fails = np.isnan(found.time).reshape(-1, values.size).any(axis=0)
    count = int(fails.argmax()) if fails.any() else values.size
    return float(values[count - 1]) if count else np.nan


def _in_xz_plane(x: Floats, z: Floats) -> Floats:
    return np.column_stack([x, np.zeros_like(x), z])


def _tilt_and_rate(angle: Floats, rate: Floats) -> dict[str, Floats]:
    x, z = np.sin(angle), np.cos(angle)
    return {"direction": _in_xz_plane(x, z), "direction_rate": _in_xz_plane(rate * z, -rate * x)}


def _tilt_and_offset(angle: Floats, offset: Floats) -> dict[str, Floats]:
    position = _in_xz_plane(offset, np.full_like(offset, HOVER_HEIGHT))
    return {"direction": _in_xz_plane(np.sin(angle), np.cos(angle)), "position": position}


_TILT = GridAxis("initial tilt", "rad", np.linspace(-0.7, 0.7, 25))
_TILT_RATE = GridAxis("initial tilt rate", "rad/s", np.linspace(-4.0, 4.0, 25))
_OFFSET = GridAxis("initial x of the quadrotor", "m", np.linspace(-1.5, 1.5, 25))
START_GRIDS = {
    "tilt_rate": StartGrid("Tilt and tilt rate", _TILT, _TILT_RATE, _tilt_and_rate),
    "tilt_offset": StartGrid("Tilt and offset", _TILT, _OFFSET, _tilt_and_offset),
}
# From hover outwards: one quantity grows, and the other one is zero.
_GRID, _NONE = START_GRIDS["tilt_rate"], np.zeros(1)
_GROWING_TILT, _GROWING_RATE = np.radians(np.arange(60.0)), np.radians(np.arange(0.0, 300.0, 5.0))
START_LINES = {
    "tilt": replace(_GRID, x=_TILT._replace(values=_GROWING_TILT), y=_TILT_RATE._replace(values=_NONE)),
    "tilt_rate": replace(_GRID, x=_TILT._replace(values=_NONE), y=_TILT_RATE._replace(values=_GROWING_RATE)),
}
