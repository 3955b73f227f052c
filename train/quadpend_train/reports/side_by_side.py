"""Recorded episodes side by side, in a window or as a video."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygame
from PIL import Image
from tqdm import tqdm

from quadpend_gym.viewer import palette
from quadpend_gym.viewer.picture import Picture, surface_to_array
from quadpend_gym.viewer.primitives import write
from quadpend_train.common.files import atomic
from quadpend_train.evaluation.recording import Recording

COLOURS = (palette.VERMILLION, palette.VIOLET, palette.BROWN, (204, 121, 167))  # of the recordings, from the left


class SideBySideView:
    """A view of one to four recordings, side by side.

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
        self._recordings = recordings

    def draw(self, surface: Any, step: int) -> None:
        """Draw the state after a step, counted from 0. A recording that has ended stays at its last snapshot."""
        width, height = surface.get_size()
        surface.fill(palette.WHITE)
        n = len(self._recordings)
        for i, recording in enumerate(self._recordings):
            left, right = width * i // n, width * (i + 1) // n
            part = surface.subsurface((left, 0, right - left - (i < n - 1), height))
            last = len(recording.snapshots) - 1
            self.picture.draw(part, recording.snapshots[min(step, last)], recording.name, COLOURS[i])
            if step >= last and recording.fell_at is not None:
                middle = part.get_width() / 2, 0.62 * height
                write(part, f"fell at {recording.fell_at:.1f} s", middle, height // 16, palette.INK, "center")


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
