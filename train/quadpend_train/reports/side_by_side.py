"""Recordings of one episode side by side, above curves of their errors and of the wind that they saw."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pygame

from quadpend_gym.core.arrays import Floats
from quadpend_gym.viewer import palette
from quadpend_gym.viewer.palette import Colour, blend
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.primitives import line
from quadpend_train.evaluation.recording import Recording

COLOURS = (palette.VERMILLION, palette.VIOLET, palette.BROWN)  # of the policies, from the left
TRUE = blend(palette.WIND, palette.WHITE, 0.35)  # of the wind as it was
_CURVES = 0.3  # of the height, for the curves
_LEAST = 1.0  # mm, the smallest error on the chart


class Curve(NamedTuple):
    """A line over time; nan where there is none."""

    values: Floats
    colour: Colour
    width: int
    dashed: bool = False


class Chart(NamedTuple):
    """Curves on common axes, with the names that stand behind the title, and what to write at which height."""

    title: str
    names: tuple[tuple[str, Colour], ...]
    curves: tuple[Curve, ...]
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]


class SideBySideView:
    """Draws recordings of the same episode at one instant.

    Args:
        recordings: one to three, of the same scenario and seed.
        period: s, between two snapshots.
        seconds: from when to when to show.

    Attributes:
        steps: the first to show and the one after the last, counted from 0.

    Raises:
        ValueError: all episodes are over before.
    """

    def __init__(self, recordings: Sequence[Recording], period: float, seconds: tuple[float, float]) -> None:
        """Prepare the curves."""
        longest = max(len(recording.snapshots) for recording in recordings)
        self.steps = range(round(seconds[0] / period), min(round(seconds[1] / period), longest))
        if not self.steps:
            raise ValueError(f"the episode is over after {longest * period:g} s, before {seconds[0]:g} s")
        self.picture = Picture()
        self._recordings, self._period = recordings, period
        shown = slice(self.steps.start, self.steps.stop)
        self._charts = (_error_chart(recordings, shown), _wind_chart(recordings, shown))

    def draw(self, surface: Any, step: int) -> None:
        """Draw what there was after a number of steps over the whole of a surface."""
        width, height = surface.get_size()
        surface.fill(palette.WHITE)
        below = round(height * (1.0 - _CURVES))
        n = len(self._recordings)
        for i, recording in enumerate(self._recordings):
            left, right = width * i // n, width * (i + 1) // n
            part = surface.subsurface((left, 0, right - left - (i < n - 1), below))
            last = len(recording.snapshots) - 1
            self.picture.draw(part, recording.snapshots[min(step, last)], recording.name, COLOURS[i])
            if step >= last and recording.fell_at is not None:
                self._tell_of_fall(part, recording.fell_at)
        for i, chart in enumerate(self._charts):
            left, right = width * i // 2, width * (i + 1) // 2
            self._draw_chart(surface.subsurface((left, below, right - left, height - below)), chart, step)

    def _tell_of_fall(self, surface: Any, time: float) -> None:
        width, height = surface.get_size()
        veil = pygame.Surface((width, height))
        veil.fill(palette.WHITE)
        veil.set_alpha(90)
        surface.blit(veil, (0, 0))
        self.picture.text.write(
            surface, f"fell at {time:.1f} s", (width / 2, 0.62 * height), height // 12, palette.INK, "center"
        )

    def _draw_chart(self, surface: Any, chart: Chart, step: int) -> None:
        width, height = surface.get_size()
        size = max(round(height / 9.5), 12)
        write = self.picture.text.write
        left, right, top, bottom = 2.6 * size, width - 0.8 * size, 1.6 * size, height - 1.6 * size
        begin, end = self.steps.start * self._period, self.steps.stop * self._period
        across, scale = (right - left) / (end - begin), (bottom - top) / (chart.high - chart.low)
        x = left
        for text, colour in ((chart.title, palette.INK), *chart.names):
            x = write(surface, text, (x, 0.35 * size), size, colour) + 0.6 * size
        for value, text in chart.ticks:
            y = bottom - scale * (value - chart.low)
            pygame.draw.line(surface, blend(palette.GRID, palette.WHITE, 0.5), (left, y), (right, y))
            write(surface, text, (left - 0.4 * size, y), size, palette.GREY, "midright")
        for second in _ticks(begin, end):
            x = left + across * (second - begin)
            write(surface, f"{second:g} s", (x, bottom + 0.3 * size), size, palette.GREY, "midtop")
        for curve in chart.curves:
            shown = curve.values[self.steps.start : step + 1]
            x = left + across * self._period * (1.0 + np.arange(len(shown)))
            points = np.column_stack([x, bottom - scale * (shown - chart.low)])[::2]
            for i, (a, b) in enumerate(pairwise(points)):
                if np.isfinite(a[1] + b[1]) and not (curve.dashed and i % 8 > 4):
                    line(surface, a, b, curve.colour, curve.width)
        x = left + across * self._period * (step + 1 - self.steps.start)
        pygame.draw.line(surface, palette.GREY, (x, top), (x, bottom))


def _error_chart(recordings: Sequence[Recording], shown: slice) -> Chart:
    """Logarithms of the errors: falls and millimetres on one scale."""
    errors = [np.log10(np.maximum(1e3 * recording.error, _LEAST)) for recording in recordings]
    curves = tuple(Curve(error, COLOURS[i], 2, i == 1) for i, error in enumerate(errors))
    high = max(float(error[shown].max(initial=1.0)) for error in errors)
    powers = range(int(np.log10(_LEAST)), int(high) + 1)
    ticks = tuple((float(power), f"{10**power}" if power else f"≤ {_LEAST:g}") for power in powers)
    return Chart("tracking error (mm)", _names(recordings), curves, np.log10(_LEAST), high + 0.1, ticks)


def _names(recordings: Sequence[Recording]) -> tuple[tuple[str, Colour], ...]:
    return tuple((recording.name, COLOURS[i]) for i, recording in enumerate(recordings))


def _wind_chart(recordings: Sequence[Recording], shown: slice) -> Chart:
    """The force on the quadrotor, as it was and as each policy took it to be, on the axis where it blew hardest."""
    longest = max(recordings, key=lambda recording: len(recording.snapshots))
    true = longest.disturbance[:, :3]
    axis = int(np.argmax((true[shown] ** 2).sum(axis=0)))
    seeing = [i for i, recording in enumerate(recordings) if np.isfinite(recording.estimate[:, axis]).any()]
    guesses = [recordings[i].estimate[:, axis] for i in seeing]
    flying = [recordings[i].estimate[shown, axis] for i in seeing if recordings[i].survived]  # who falls guesses wildly
    usual = [float(np.quantile(np.abs(guess), 0.98)) for guess in flying if len(guess)]
    reach = 1.1 * max(float(np.abs(true[shown, axis]).max()), *usual, 0.1)
    curves = [Curve(true[:, axis], TRUE, 5)]
    for i, guess in zip(seeing, guesses, strict=True):
        curves.append(Curve(np.where(np.abs(guess) <= reach, guess, np.nan), COLOURS[i], 2, i == 1))
    names = (("true", blend(TRUE, palette.INK, 0.3)), *(_names(recordings)[i] for i in seeing))
    ticks = tuple((float(value), f"{value:g}") for value in _ticks(-reach, reach))
    return Chart(f"wind along {'xyz'[axis]} (N)", names, tuple(curves), -reach, reach, ticks)


def _ticks(low: float, high: float) -> Floats:
    """Three to six round numbers between two, ends included."""
    rough = (high - low) / 5.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return np.asarray(np.round(np.arange(first, last + 1.0) * step, 10) + 0.0)  # no −0
