"""Time series of wind models, computed without an environment, for plots and tests."""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import WIND_STREAM, Streams
from quadpend_gym.vehicles import CONTROL_PERIOD
from quadpend_gym.wind.base import WIND_SIZE

__all__ = ["time_series"]


def time_series(
    models: tuple[Any, ...], steps: int, rows: int = 1, seed: int = 0, period: float = CONTROL_PERIOD
) -> Floats:
    """Return the wind during the first episodes of the seeds `seed`, `seed` + 1, …, shape (steps, rows, 12).

    The values are the same as in environments with these seeds and this wind.

    Args:
        models: Wind models, as returned by `as_wind`.
        steps: Number of control steps.
        rows: Number of episodes.
        seed: Seed of the first episode.
        period: Duration of a control step, s.
    """
    batch, out = ModelBatch(models, rows), np.zeros((steps, WIND_SIZE, rows)).swapaxes(1, 2)
    clock = np.zeros(rows, np.int64)
    streams = Streams.from_seeds([seed + row for row in range(rows)]).derive(0).derive(WIND_STREAM)
    batch.start_episodes(
        np.arange(rows), streams, lambda model, *own: model.sample(out[0], own[0], clock, period, own[1])
    )
    for current in out[1:]:
        clock += 1
        _sample(batch, current, clock, period)
    return out


def _sample(batch: ModelBatch, out: Floats, clock: Any, period: float) -> None:
    batch.apply(lambda model, memory, streams: model.sample(out, memory, clock, period, streams))
