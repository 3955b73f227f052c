"""A view of recorded episodes side by side, above charts of their tracking errors and of the wind."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pygame

from quadpend_gym.core.arrays import Floats
from quadpend_gym.viewer import palette
from quadpend_gym.viewer.palette import Colour, blend
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.primitives import line, write
from quadpend_train.evaluation.recording import Recording

COLOURS = (palette.VERMILLION, palette.VIOLET, palette.BROWN)  # of the policies, from the left
TRUE_WIND = blend(palette.WIND, palette.WHITE, 0.35)
_CHART_HEIGHT = 0.3  # share of the height of the view
_SMALLEST_ERROR = 1.0  # mm, lower end of the error chart


class Curve(NamedTuple):
    """A curve over time, with gaps where a value is nan."""

    values: Floats
    colour: Colour
    width: int
    dashed: bool = False


class Chart(NamedTuple):
    """Curves on common axes.

    Attributes:
        title: Title.
        legend: Labels and colours, which follow the title.
        curves: Curves.
        low: Lower end of the vertical axis.
        high: Upper end of the vertical axis.
        ticks: Values and labels of the ticks on the vertical axis.
    """

    title: str
    legend: tuple[tuple[str, Colour], ...]
    curves: tuple[Curve, ...]
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]


class SideBySideView:
    """A view of one to three recordings of the same episode, side by side, above charts.

    Args:
        recordings: Recordings of the same scenario and seed.
        period: Time between two snapshots, s.
        seconds: Begin and end of the part of the episode to show, s.

    Attributes:
        steps: Steps of that part, counted from 0.
        picture: Picture that draws each recording; its camera may be changed.

    Raises:
        ValueError: If all recordings end before that part begins.
    """

    def __init__(self, recordings: Sequence[Recording], period: float, seconds: tuple[float, float]) -> None:
        """Prepare the charts."""
        longest = max(len(recording.snapshots) for recording in recordings)
        self.steps = range(round(seconds[0] / period), round(min(seconds[1] / period, longest)))
        if not self.steps:
            raise ValueError(f"the episode is over after {longest * period:g} s, before {seconds[0]:g} s")
        self.picture = Picture()
        self._recordings, self._period = recordings, period
        shown = slice(self.steps.start, self.steps.stop)
        self._charts = (_error_chart(recordings, shown), _wind_chart(recordings, shown))

    def draw(self, surface: Any, step: int) -> None:
        """Draw the state after a step over the whole of a surface.

        Args:
            surface: Surface of pygame to draw on.
            step: Step, counted from 0. A recording that has ended stays at its last snapshot.
        """
        width, height = surface.get_size()
        surface.fill(palette.WHITE)
        chart_top = round(height * (1.0 - _CHART_HEIGHT))
        n = len(self._recordings)
        for i, recording in enumerate(self._recordings):
            left, right = width * i // n, width * (i + 1) // n
            part = surface.subsurface((left, 0, right - left - (i < n - 1), chart_top))
            last = len(recording.snapshots) - 1
            self.picture.draw(part, recording.snapshots[min(step, last)], recording.name, COLOURS[i])
            if step >= last and recording.fell_at is not None:
                self._draw_fall(part, recording.fell_at)
        for i, chart in enumerate(self._charts):
            left, right = width * i // 2, width * (i + 1) // 2
            self._draw_chart(surface.subsurface((left, chart_top, right - left, height - chart_top)), chart, step)

    def _draw_fall(self, surface: Any, time: float) -> None:
        """Fade the picture of a policy and write when it fell, s."""
        width, height = surface.get_size()
        veil = pygame.Surface((width, height))
        veil.fill(palette.WHITE)
        veil.set_alpha(90)
        surface.blit(veil, (0, 0))
        write(surface, f"fell at {time:.1f} s", (width / 2, 0.62 * height), height // 12, palette.INK, "center")

    def _draw_chart(self, surface: Any, chart: Chart, step: int) -> None:
        width, height = surface.get_size()
        size = max(round(height / 9.5), 12)
        left, right, top, bottom = 2.6 * size, width - 0.8 * size, 1.6 * size, height - 1.6 * size
        begin, end = self.steps.start * self._period, self.steps.stop * self._period
        x_scale, y_scale = (right - left) / (end - begin), (bottom - top) / (chart.high - chart.low)
        x = left
        for text, colour in ((chart.title, palette.INK), *chart.legend):
            x = write(surface, text, (x, 0.35 * size), size, colour) + 0.6 * size
        for value, text in chart.ticks:
            y = bottom - y_scale * (value - chart.low)
            pygame.draw.line(surface, blend(palette.GRID, palette.WHITE, 0.5), (left, y), (right, y))
            write(surface, text, (left - 0.4 * size, y), size, palette.GREY, "midright")
        for second in _round_values(begin, end):
            x = left + x_scale * (second - begin)
            write(surface, f"{second:g} s", (x, bottom + 0.3 * size), size, palette.GREY, "midtop")
        for curve in chart.curves:
            values = curve.values[self.steps.start : step + 1]
            x = left + x_scale * self._period * (1.0 + np.arange(len(values)))
            points = np.column_stack([x, bottom - y_scale * (values - chart.low)])[::2]
            for i, (a, b) in enumerate(pairwise(points)):
                if np.isfinite(a[1] + b[1]) and not (curve.dashed and i % 8 > 4):
                    line(surface, a, b, curve.colour, curve.width)
        x = left + x_scale * self._period * (step + 1 - self.steps.start)
        pygame.draw.line(surface, palette.GREY, (x, top), (x, bottom))


def _error_chart(recordings: Sequence[Recording], shown: slice) -> Chart:
    """Return a chart of the tracking errors on a logarithmic axis, which shows falls and millimetres together."""
    errors = [np.log10(np.maximum(1e3 * recording.error, _SMALLEST_ERROR)) for recording in recordings]
    curves = tuple(Curve(error, COLOURS[i], 2, i == 1) for i, error in enumerate(errors))
    high = max(float(error[shown].max(initial=1.0)) for error in errors)
    powers = range(int(np.log10(_SMALLEST_ERROR)), int(high) + 1)
    ticks = tuple((float(power), f"{10**power}" if power else f"≤ {_SMALLEST_ERROR:g}") for power in powers)
    return Chart("tracking error (mm)", _legend(recordings), curves, np.log10(_SMALLEST_ERROR), high + 0.1, ticks)


def _legend(recordings: Sequence[Recording]) -> tuple[tuple[str, Colour], ...]:
    return tuple((recording.name, COLOURS[i]) for i, recording in enumerate(recordings))


def _wind_chart(recordings: Sequence[Recording], shown: slice) -> Chart:
    """Return a chart of the wind's force on the quadrotor and its estimates, along the axis with the largest force."""
    longest = max(recordings, key=lambda recording: len(recording.snapshots))
    true = longest.disturbance[:, :3]
    axis = int(np.argmax((true[shown] ** 2).sum(axis=0)))
    estimating = [i for i, recording in enumerate(recordings) if np.isfinite(recording.estimate[:, axis]).any()]
    estimates = [recordings[i].estimate[:, axis] for i in estimating]
    # The estimates of a policy that falls become very large, so they do not determine the range of the axis.
    surviving = [recordings[i].estimate[shown, axis] for i in estimating if recordings[i].survived]
    typical = [float(np.quantile(np.abs(estimate), 0.98)) for estimate in surviving if len(estimate)]
    limit = 1.1 * max(float(np.abs(true[shown, axis]).max()), *typical, 0.1)
    curves = [Curve(true[:, axis], TRUE_WIND, 5)]
    for i, estimate in zip(estimating, estimates, strict=True):
        curves.append(Curve(np.where(np.abs(estimate) <= limit, estimate, np.nan), COLOURS[i], 2, i == 1))
    legend = (("true", blend(TRUE_WIND, palette.INK, 0.3)), *(_legend(recordings)[i] for i in estimating))
    ticks = tuple((float(value), f"{value:g}") for value in _round_values(-limit, limit))
    return Chart(f"wind along {'xyz'[axis]} (N)", legend, tuple(curves), -limit, limit, ticks)


def _round_values(low: float, high: float) -> Floats:
    """Return three to six round numbers in an interval, including its ends if they are round."""
    rough = (high - low) / 5.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return np.asarray(np.round(np.arange(first, last + 1.0) * step, 10) + 0.0)  # adding 0 turns −0 into 0
