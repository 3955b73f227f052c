"""Recordings of one episode side by side, above curves of their errors and of the wind that they saw."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pygame

from quadpend_gym.arrays import Floats
from quadpend_gym.viewer import Picture
from quadpend_gym.viewer import palette as paint
from quadpend_gym.viewer.brush import line
from quadpend_gym.viewer.palette import Colour, mixed
from train.recording import Recording

COLOURS = (paint.VERMILLION, paint.PURPLE, paint.ORANGE, paint.INK)  # of the policies, from the left
_CURVES = 0.3  # of the height, for the curves


class Curve(NamedTuple):
    """A line over time; nan where there is none."""

    values: Floats
    colour: Colour
    width: int


class Chart(NamedTuple):
    """Curves on common axes."""

    title: str
    names: tuple[tuple[str, Colour], ...]  # to stand behind the title
    curves: tuple[Curve, ...]
    low: float
    high: float


class Board:
    """Draws recordings of the same episode at one instant.

    Args:
        recordings: one to four, of the same scenario and seed.
        period: s, between two snapshots.
        seconds: from when to when to show.

    Attributes:
        steps: the first to show and the one after the last.

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
        self._charts = (_error_chart(recordings), _wind_chart(recordings))

    def draw(self, surface: Any, step: int) -> None:
        """Draw what there was after a number of steps over the whole of a surface."""
        width, height = surface.get_size()
        surface.fill(paint.PAPER)
        below = round(height * (1.0 - _CURVES))
        n = len(self._recordings)
        for i, recording in enumerate(self._recordings):
            left, right = width * i // n, width * (i + 1) // n
            part = surface.subsurface((left, 0, right - left - (i < n - 1), below))
            last = len(recording.snapshots) - 1
            self.picture.draw(part, recording.snapshots[min(step, last)], recording.name, COLOURS[i])
            if step > last and not recording.survived:
                self._tell_of_fall(part, (last + 1) * self._period)
        for i, chart in enumerate(self._charts):
            left, right = width * i // 2, width * (i + 1) // 2
            self._draw_chart(surface.subsurface((left, below, right - left, height - below)), chart, step)

    def _tell_of_fall(self, surface: Any, time: float) -> None:
        width, height = surface.get_size()
        veil = pygame.Surface((width, height))
        veil.fill(paint.PAPER)
        veil.set_alpha(120)
        surface.blit(veil, (0, 0))
        self.picture.letters.write(
            surface, f"fell at {time:.1f} s", (width / 2, height / 2), height // 9, paint.INK, "center"
        )

    def _draw_chart(self, surface: Any, chart: Chart, step: int) -> None:
        width, height = surface.get_size()
        size = max(round(height / 9.5), 12)
        write = self.picture.letters.write
        left, right, top, bottom = 2.6 * size, width - 0.8 * size, 1.6 * size, height - 1.6 * size
        begin, end = self.steps.start * self._period, self.steps.stop * self._period
        across = (right - left) / (end - begin)
        scale = (bottom - top) / (chart.high - chart.low)
        x = left
        for text, colour in ((chart.title, paint.INK), *chart.names):
            x = write(surface, text, (x, 0.35 * size), size, colour) + 0.6 * size
        for value in _ticks(chart.low, chart.high):
            y = bottom - scale * (value - chart.low)
            pygame.draw.line(surface, mixed(paint.GRID, paint.PAPER, 0.5), (left, y), (right, y))
            write(surface, f"{value:g}", (left - 0.4 * size, y), size, paint.FAINT, "midright")
        for second in _ticks(begin, end):
            x = left + across * (second - begin)
            write(surface, f"{second:g} s", (x, bottom + 0.3 * size), size, paint.FAINT, "midtop")
        for curve in chart.curves:
            shown = curve.values[self.steps.start : step + 1]
            x = left + across * self._period * np.arange(len(shown))
            points = np.column_stack([x, bottom - scale * (np.clip(shown, chart.low, chart.high) - chart.low)])
            points = points[np.isfinite(shown)]
            for a, b in zip(points[:-1:2].tolist(), points[2::2].tolist(), strict=False):
                line(surface, a, b, curve.colour, curve.width)
        x = left + across * self._period * (step - self.steps.start)
        pygame.draw.line(surface, paint.FAINT, (x, top), (x, bottom))


def _error_chart(recordings: Sequence[Recording]) -> Chart:
    curves = tuple(Curve(1e3 * recording.error, COLOURS[i], 2) for i, recording in enumerate(recordings))
    largest = max((float(curve.values.max()) for curve in curves if len(curve.values)), default=1.0)
    return Chart("tracking error (mm)", _names(recordings), curves, 0.0, 1.05 * max(largest, 1.0))


def _names(recordings: Sequence[Recording]) -> tuple[tuple[str, Colour], ...]:
    return tuple((recording.name, COLOURS[i]) for i, recording in enumerate(recordings))


def _wind_chart(recordings: Sequence[Recording]) -> Chart:
    """The force on the quadrotor, as it was and as each policy took it to be, on the axis where it blew hardest."""
    longest = max(recordings, key=lambda recording: len(recording.snapshots))
    true = longest.disturbance[:, :3]
    axis = int(np.argmax((true**2).sum(axis=0))) if len(true) else 0
    curves = [Curve(true[:, axis], mixed(paint.WIND, paint.PAPER, 0.35), 5)]
    curves += [Curve(recording.estimate[:, axis], COLOURS[i], 2) for i, recording in enumerate(recordings)]
    reach = 1.3 * max(float(np.abs(true[:, axis]).max(initial=0.0)), 0.1)
    seeing = [name for name, recording in zip(_names(recordings), recordings, strict=True) if not _blind(recording)]
    return Chart(
        f"wind along {'xyz'[axis]} (N)",
        (("true", mixed(paint.WIND, paint.INK, 0.2)), *seeing),
        tuple(curves),
        -reach,
        reach,
    )


def _blind(recording: Recording) -> bool:
    """Whether a policy estimates no wind."""
    return bool(np.isnan(recording.estimate).all())


def _ticks(low: float, high: float) -> Floats:
    """Three to six round numbers between two."""
    rough = (high - low) / 5.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    return np.asarray(np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1.0) * step, 10))
