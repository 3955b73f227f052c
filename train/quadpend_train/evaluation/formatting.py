"""Numbers, confidence intervals and tables as text."""

from collections.abc import Iterable, Sequence

import numpy as np

from quadpend_train.evaluation.statistics import Interval


def format_number(value: float, like: float | None = None) -> str:
    """Return a number with about three digits, or with as many decimals as another one `like` it; a dash for nan."""
    if np.isnan(value):
        return "–"
    size = abs(value if like is None else like)
    return f"{value:.{0 if size >= 100 else 1 if size >= 10 else 2}f}"


def format_interval(interval: Interval) -> str:
    """Return an estimate with its interval, such as ``20.2 [19.3, 21.1]``; a dash if the estimate is nan."""
    if np.isnan(interval.value):
        return "–"
    smallest = min(abs(interval.value), abs(interval.low) or abs(interval.value))  # 99.5 is not rounded to 100
    value, low, high = (format_number(number, smallest) for number in interval)
    return f"{value} [{low}, {high}]"


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
