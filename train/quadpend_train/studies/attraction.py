"""Regions of attraction: from which starts a policy finds back to hover, on a grid, in calm air.

An episode has *recovered* when the tracking error stays below `SETTLED_WITHIN` over its last second; the time to
recover is then when the error was last above it. The grid is symmetric about hover, and nothing is drawn at random: two
numbers of the start are the grid's, all others those of hover.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_train.evaluation.episodes import STEPS, EpisodeResults
from quadpend_train.scenarios import HOVER, Scenario

SETTLED_WITHIN = 0.05  # m
HEIGHT = 2.0  # m, of the hover point above the origin
CALM_HOVER = Scenario("hover in calm air", env_id=HOVER)
_PERIOD = 0.01  # s
_LAST = 100  # steps, the last second


class RecoveryOutcome(IntEnum):
    """How an episode ended."""

    FELL = 0
    UNSETTLED = 1  # survived, but away from the hover point
    RECOVERED = 2


class Side(NamedTuple):
    """One side of a map."""

    title: str
    unit: str
    values: Floats  # symmetric about 0


@dataclass(frozen=True)
class Map:
    """Starts on a grid.

    Attributes:
        title: of the map.
        x: the side to the right.
        y: the side upwards.
        start: fields of the state (`quadpend_gym.physics.state`), of x and y, shapes (n,); the others are those of hover.
    """

    title: str
    x: Side
    y: Side
    start: Callable[[Floats, Floats], dict[str, Floats]]

    def options(self) -> dict[str, Any]:
        """What `reset` takes to start the grid's episodes, row by row from the lowest y, x fastest."""
        x, y = (side.ravel() for side in np.meshgrid(self.x.values, self.y.values))
        hover = {"position": (0.0, 0.0, HEIGHT), "direction": (0.0, 0.0, 1.0)}
        still = dict.fromkeys(("velocity", "euler", "euler_rate", "direction_rate"), (0.0, 0.0, 0.0))
        return {"state": {**still, **hover, **self.start(x, y)}}


class RecoveryMap(NamedTuple):
    """What became of a map's starts.

    Attributes:
        outcome: an `Outcome` for each training seed, y and x, shape (s, ny, nx).
        time: to recover, s; nan where it did not, same shape.
    """

    outcome: Integers
    time: Floats

    @property
    def recovered(self) -> float:
        """Share of the starts that recovered, over all training seeds."""
        return float(np.mean(self.outcome == RecoveryOutcome.RECOVERED))


def _plane(x: Floats, y: Floats) -> Floats:
    """Vectors in the x–z plane, shape (n, 3)."""
    return np.column_stack([x, np.zeros_like(x), y])


def _tilt(angle: Floats) -> Floats:
    """Directions of a pendulum that leans by `angle` (rad) towards x, shape (n, 3)."""
    return _plane(np.sin(angle), np.cos(angle))


def _swinging(angle: Floats, rate: Floats) -> dict[str, Floats]:
    return {"direction": _tilt(angle), "direction_rate": _plane(rate * np.cos(angle), -rate * np.sin(angle))}


def _displaced(angle: Floats, offset: Floats) -> dict[str, Floats]:
    return {"direction": _tilt(angle), "position": _plane(offset, np.full_like(offset, HEIGHT))}


_TILTS = Side("initial tilt", "rad", np.linspace(-0.7, 0.7, 25))
MAPS = {
    "tilt_rate": Map(
        "Tilt and its rate", _TILTS, Side("initial tilt rate", "rad/s", np.linspace(-4.0, 4.0, 25)), _swinging
    ),
    "tilt_offset": Map(
        "Tilt and distance", _TILTS, Side("initial x of the quadrotor", "m", np.linspace(-1.5, 1.5, 25)), _displaced
    ),
}


def classify(flights: EpisodeResults, item: Map) -> RecoveryMap:
    """The outcomes of a map's flights, in the order of `Map.options`."""
    far = ~(flights.error < SETTLED_WITHIN)
    recovered = flights.survived & ~far[..., -_LAST:].any(axis=-1)
    outcome = np.where(
        recovered,
        RecoveryOutcome.RECOVERED,
        np.where(flights.survived, RecoveryOutcome.UNSETTLED, RecoveryOutcome.FELL),
    )
    steps = np.where(far.any(axis=-1), STEPS - np.argmax(far[..., ::-1], axis=-1), 0)  # up to the last far one
    grid = (len(outcome), item.y.values.size, item.x.values.size)
    return RecoveryMap(outcome.reshape(grid), np.where(recovered, _PERIOD * steps, np.nan).reshape(grid))
