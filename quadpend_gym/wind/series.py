"""A wind over time, without an environment: for plots and tests of what one trains in."""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import WIND_STREAM, Streams
from quadpend_gym.physics.parameters import CONTROL_PERIOD
from quadpend_gym.wind.base import WIND_SIZE


def series(models: tuple[Any, ...], steps: int, rows: int = 1, seed: int = 0, period: float = CONTROL_PERIOD) -> Floats:
    """What blows in each step of the first episodes of the seeds `seed`, `seed` + 1, …, shape (steps, rows, 12).

    The numbers are those of an environment with these seeds and this wind.

    Args:
        models: as `as_wind` gives them.
        steps: number of control periods.
        rows: number of episodes.
        seed: of the first episode.
        period: of a control step, s.
    """
    process, out = ModelBatch(models, rows), np.zeros((steps, WIND_SIZE, rows)).swapaxes(1, 2)
    clock = np.zeros(rows, np.int64)
    streams = Streams.from_seeds([seed + row for row in range(rows)]).derive(0).derive(WIND_STREAM)
    process.begin(np.arange(rows), streams, lambda model, *own: model.sample(out[0], own[0], clock, period, own[1]))
    for blown in out[1:]:
        clock += 1
        _blow(process, blown, clock, period)
    return out


def _blow(process: ModelBatch, out: Floats, clock: Any, period: float) -> None:
    process.work(lambda model, memory, streams: model.sample(out, memory, clock, period, streams))
