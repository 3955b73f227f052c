"""Recorded episodes side by side, above charts of their tracking errors and of the wind; in a window or as a video."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygame
from PIL import Image
from tqdm import tqdm

from quadpend_gym.viewer import palette
from quadpend_gym.viewer.palette import blend
from quadpend_gym.viewer.picture import Picture, surface_to_array
from quadpend_gym.viewer.primitives import write
from quadpend_train.common.files import atomic
from quadpend_train.evaluation.recording import Recording
from quadpend_train.reports import figures

COLOURS = (palette.VERMILLION, palette.VIOLET, palette.BROWN, (204, 121, 167))  # of the recordings, from the left
_TRUE_WIND = blend(palette.WIND, palette.WHITE, 0.35)
_CHART_HEIGHT = 0.3  # share of the height of the view
_SMALLEST_ERROR = 1.0  # mm, lower end of the error chart
_DPI = 100  # pixels per inch of the charts


class SideBySideView:
    """A view of one to four recordings, side by side, above charts.

    `period` is the time between two snapshots, and `seconds` are begin and end of the part of the episode to show, s.

    Attributes:
        steps: Steps of that part, counted from 0.
        picture: Picture that draws each recording; its camera may be changed.
    """

    def __init__(self, recordings: Sequence[Recording], period: float, seconds: tuple[float, float]) -> None:
        longest = max(len(recording.snapshots) for recording in recordings)
        self.steps = range(round(seconds[0] / period), round(min(seconds[1] / period, longest)))
        if not self.steps:
            first, last = seconds
            raise ValueError(f"an episode of {longest * period:g} s has no step between {first:g} and {last:g} s")
        self.picture = Picture()
        self._recordings, self._period = recordings, period
        self._charts: _Charts | None = None

    def draw(self, surface: Any, step: int) -> None:
        """Draw the state after a step, counted from 0. A recording that has ended stays at its last snapshot."""
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
                middle = part.get_width() / 2, 0.62 * chart_top
                write(part, f"fell at {recording.fell_at:.1f} s", middle, chart_top // 12, palette.INK, "center")
        size = (width, height - chart_top)
        if self._charts is None or self._charts.size != size:
            self._charts = _Charts(self._recordings, self._period, self.steps, size)
        self._charts.draw(surface.subsurface((0, chart_top, *size)), self._period * (step + 1))


class _Charts:
    """Charts of tracking errors and wind, drawn once, with a line at the present."""

    def __init__(self, recordings: Sequence[Recording], period: float, steps: range, size: tuple[int, int]) -> None:
        self.size = width, height = size
        line = max(height / 14.0, 7.0)  # height of a line of text, px
        figure = figures.new_figure(width / _DPI, height / _DPI)
        figure.set(dpi=_DPI, layout_engine="none")
        self._axes, points = figures.add_axes(figure, 1, 2)[0], 72.0 / _DPI * line
        for i, draw in enumerate((_draw_errors, _draw_wind)):
            axis = self._axes[i]
            left, bottom = 0.5 * i + 4.5 * line / width, 1.8 * line / height
            axis.set_position((left, bottom, 0.5 - 5.5 * line / width, 1.0 - 2.0 * bottom))
            draw(axis, recordings, period, slice(steps.start, steps.stop))
            axis.set_xlim(period * steps.start, period * steps.stop)
            axis.xaxis.set_major_formatter("{x:g} s")
            axis.grid(color="#dddddd", linewidth=0.5)
            axis.tick_params(labelsize=points)
            axis.yaxis.label.set_size(points)
            axis.legend(loc="lower left", bbox_to_anchor=(0.0, 0.97), ncols=4, frameon=False, fontsize=points)
        figure.canvas.draw()
        pixels = figure.canvas.buffer_rgba()
        self._curves = pygame.image.frombuffer(bytes(pixels), pixels.shape[1::-1], "RGBA")

    def draw(self, surface: Any, time: float) -> None:
        """Draw the charts with a line at a time, s."""
        surface.blit(self._curves, (0, 0))
        for axis in self._axes:
            now = round(axis.transData.transform((time, 1.0))[0])
            top, bottom = self.size[1] - axis.bbox.y1, self.size[1] - axis.bbox.y0
            pygame.draw.line(surface, palette.GREY, (now, top), (now, bottom))


def _draw_curve(axis: Any, values: Any, period: float, i: int) -> None:
    """Draw a curve in the style of recording i."""
    times = period * np.arange(1, len(values) + 1)
    colour = np.array(COLOURS[i]) / 255.0
    axis.plot(times, values, "--" if i == 1 else "-", color=colour, linewidth=1.5)


def _draw_errors(axis: Any, recordings: Sequence[Recording], period: float, shown: slice) -> None:
    """Draw the tracking errors on a logarithmic axis, which shows falls and millimetres together."""
    errors = [np.maximum(1e3 * recording.error, _SMALLEST_ERROR) for recording in recordings]
    for i, error in enumerate(errors):
        _draw_curve(axis, error, period, i)
        axis.lines[-1].set_label(recordings[i].name)
    highest = max(float(error[shown].max(initial=10.0)) for error in errors)
    figures.set_log_scale(axis, _SMALLEST_ERROR, highest)
    axis.set_ylabel("error (mm)")


def _draw_wind(axis: Any, recordings: Sequence[Recording], period: float, shown: slice) -> None:
    """Draw the wind's force on the quadrotor and its estimates, along the axis with the largest force."""
    winds: list[Any] = []  # of the recordings, each once
    for recording in sorted(recordings, key=lambda recording: -len(recording.snapshots)):
        wind = recording.disturbance[:, :3]
        if not any(np.array_equal(wind, other[: len(wind)]) for other in winds):
            winds.append(wind)
    component = int(np.argmax(max((wind[shown] ** 2).sum(axis=0).tolist() for wind in winds)))
    for i, wind in enumerate(winds):
        label = "" if i else "true; policies: their estimates"
        times = period * np.arange(1, len(wind) + 1)
        axis.plot(times, wind[:, component], color=np.array(_TRUE_WIND) / 255.0, linewidth=3.5, label=label)
    limit = max(0.1, *(float(np.abs(wind[shown, component]).max(initial=0.0)) for wind in winds))
    for i, recording in enumerate(recordings):
        estimate = recording.estimate[:, component]
        if not np.isfinite(estimate).any():
            continue
        _draw_curve(axis, estimate, period, i)
        # The estimates of a policy that falls become very large, so they do not determine the range of the axis.
        if recording.survived and len(estimate[shown]):
            limit = max(limit, float(np.quantile(np.abs(estimate[shown]), 0.98)))
    axis.set_ylim(-1.1 * limit, 1.1 * limit)
    axis.set_ylabel(f"wind, {'xyz'[component]} (N)")


def write_video(view: SideBySideView, path: Path, size: tuple[int, int], fps: float, rate: float) -> None:
    """Write a video (.mp4, .gif, .webp), or the last picture if the file is a PNG.

    `size` is in pixels, and `rate` the number of control steps that one second of the video shows.
    """
    seconds = round(100.0 / fps) / 100.0 if path.suffix == ".gif" else 1.0 / fps  # GIF stores hundredths of a second
    steps = np.arange(view.steps.start, view.steps.stop, rate * seconds).astype(int).tolist()
    with atomic(path) as unfinished:
        if path.suffix == ".png":
            Image.fromarray(next(_pictures(view, size, [view.steps[-1]]))).save(unfinished)
        elif path.suffix == ".mp4":
            from imageio.v2 import get_writer

            with get_writer(unfinished, fps=fps, quality=8, macro_block_size=2) as writer:
                for picture in _pictures(view, size, steps):
                    writer.append_data(picture)  # type: ignore[attr-defined]
        else:
            images = (Image.fromarray(picture) for picture in _pictures(view, size, steps))
            next(images).save(unfinished, save_all=True, append_images=images, duration=1000.0 * seconds, loop=0)


def _pictures(view: SideBySideView, size: tuple[int, int], steps: list[int]) -> Iterator[Any]:
    """Yield the picture after each of these steps, shape (height, width, 3), uint8."""
    surface = pygame.Surface(size)
    for step in tqdm(steps, desc="drawing", disable=None if len(steps) > 1 else True):
        view.draw(surface, step)
        yield surface_to_array(surface)
