"""Helpers of the wind tests: time series of models, an example of every kind, and statistical tolerances."""

from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
import pytest

from quadpend_gym import (
    Constant,
    Drawn,
    Dryden,
    Gusts,
    OrnsteinUhlenbeck,
    PaperGusts,
    Rescaled,
    Sinusoid,
    Step,
)
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import ModelBatch
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind import SAMPLE_SIZE, WIND_SIZE, Relative, Sum, Wind, as_wind

PERIOD = 0.01
# One model of every kind but a hand, each of them non-zero within the first steps.
EXAMPLES: dict[str, Any] = {
    "constant": Constant(force=0.5, bob_force=(0.0, 0.1, 0.0), torque=0.02, velocity=(1.0, -2.0, 0.5)),
    "sinusoid": Sinusoid(force=0.3, torque=(0.0, 0.05, 0.01), velocity=2.0, frequency=3.0),
    "step": Step(force=0.3, velocity=(3.0, 0.0, 0.0), at=(0.0, 0.03), rise=0.2),
    "drawn": Drawn(Dryden("moderate") + Constant(torque=0.02), strength=(0.5, 1.5)),
    "relative": Relative(OrnsteinUhlenbeck(force=0.3)),
    "rescaled": Rescaled(OrnsteinUhlenbeck(force=0.3, bob_force=0.1, torque=0.01, velocity=1.0) + Dryden(), 0.8),
    "gusts": Gusts(force=(0.5, 0.1, 0.2), velocity=(4.0, 0.0, 1.0), pause=(0.0, 0.05), length=(0.05, 0.1)),
    "paper_gusts": PaperGusts(force=0.4, onset=0.02, hold=0.1),
    "ornstein_uhlenbeck": OrnsteinUhlenbeck(force=0.3, torque=(0.02, 0.0, 0.0), velocity=1.0, time_constant=0.5),
    "dryden": Dryden("moderate", altitude=30.0, heading=0.5),
    "sum": Sum((OrnsteinUhlenbeck(bob_force=0.1), Gusts(velocity=3.0, pause=(0.0, 0.1)), Dryden())),
}
every_kind = pytest.mark.parametrize("wind", EXAMPLES.values(), ids=EXAMPLES.keys())


def iterate_wind(wind: Any, rows: int, period: float = PERIOD) -> Iterator[Floats]:
    """Yield the wind of each step of an endless episode, shape (rows, 16)."""
    batch = ModelBatch(as_wind(wind), rows)
    out, step = np.zeros((SAMPLE_SIZE, rows)).T, np.zeros(rows, np.int64)

    def sample(model: Wind, memory: Floats, streams: Streams) -> None:
        model.sample(out, memory, step, period, streams)

    batch.start_episodes(np.arange(rows), Streams.from_seeds(list(range(rows))), sample)
    while True:
        yield out
        out, step = np.zeros((SAMPLE_SIZE, rows)).T, step + 1
        batch.apply(sample)


def sample_wind(wind: Any, steps: int, rows: int, period: float = PERIOD, columns: slice = slice(WIND_SIZE)) -> Floats:
    """Return the wind of the first steps of an episode, shape (steps, rows, 12), or some of its columns."""
    return np.array([out[:, columns] for out in islice(iterate_wind(wind, rows, period), steps)])


def five_sigma(rows: int) -> float:
    """Return five standard errors of the mean of `rows` independent standard normal numbers.

    By chance one mean in two million deviates more. The standard error of the standard deviation is smaller by √2. That
    of the product of two correlated numbers is larger by up to √2.
    """
    return float(5.0 / np.sqrt(rows))
