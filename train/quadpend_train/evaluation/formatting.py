"""Numbers and intervals as text."""

import numpy as np

from quadpend_train.evaluation.statistics import Interval


def brief(value: float, like: float | None = None) -> str:
    """A number with as many digits as are worth reading, or as many as of `like`."""
    size = abs(value if like is None else like)
    return f"{value:.{0 if size >= 100 else 1 if size >= 10 else 2}f}"


def format_interval(interval: Interval) -> str:
    """A number with its interval; a dash if there is none."""
    if np.isnan(interval.value):
        return "–"
    value, low, high = (brief(number, _smallest(interval)) for number in interval)
    return f"{value} [{low}, {high}]"


def _smallest(interval: Interval) -> float:
    """The number that needs most digits: a share of 99.5 to 100 % is not 100 to 100; 0 needs no more than the rest."""
    return min(abs(interval.value), abs(interval.low) or abs(interval.value))
