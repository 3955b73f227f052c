"""Video files of a side-by-side view: MP4, GIF and WebP, and PNG for the last picture alone."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pygame
from PIL import Image
from tqdm import tqdm

from quadpend_gym.viewer.palette import INK, MEANINGFUL, WHITE, blend
from quadpend_gym.viewer.picture import surface_to_array
from quadpend_train.common.files import atomic
from quadpend_train.reports.side_by_side import SideBySideView

_PALETTE_SIZE = 192  # colours of a GIF file
_PALETTE_PICTURES = 4  # pictures from which these colours are chosen


def write_video(view: SideBySideView, path: Path, size: tuple[int, int], fps: float, rate: float) -> None:
    """Write a video, or the last picture if the file is a PNG. An interruption leaves an older file unchanged.

    Args:
        view: View to draw.
        path: File with the suffix .mp4, .gif, .webp or .png.
        size: Width and height in pixels.
        fps: Pictures per second.
        rate: Control steps that one second of the video shows.
    """
    shown = view.steps
    seconds = round(100.0 / fps) / 100.0 if path.suffix == ".gif" else 1.0 / fps  # GIF stores hundredths of a second
    steps = np.arange(shown.start, shown.stop, rate * seconds).astype(int).tolist()
    with atomic(path) as unfinished:
        if path.suffix == ".mp4":
            _write_mp4(_pictures(view, size, steps), unfinished, fps)
        elif path.suffix == ".png":
            _write_images(_pictures(view, size, [shown.stop - 1]), unfinished)
        else:
            sample = steps[:: max(len(steps) // _PALETTE_PICTURES, 1)]
            palette = _palette(list(_pictures(view, size, sample))) if path.suffix == ".gif" else None
            options = {"save_all": True, "duration": 1000.0 * seconds, "loop": 0}
            _write_images(_pictures(view, size, steps), unfinished, palette, **options)


def _pictures(view: SideBySideView, size: tuple[int, int], steps: list[int]) -> Iterator[Any]:
    """Yield the picture after each of these steps, shape (height, width, 3), uint8."""
    surface = pygame.Surface(size)
    for step in tqdm(steps, desc="drawing", disable=None if len(steps) > 1 else True):
        view.draw(surface, step)
        yield surface_to_array(surface)


def _write_mp4(pictures: Iterator[Any], path: Path, fps: float) -> None:
    from imageio.v2 import get_writer

    with get_writer(path, fps=fps, quality=8, macro_block_size=2) as writer:
        for picture in pictures:
            writer.append_data(picture)  # type: ignore[attr-defined]


def _write_images(pictures: Iterator[Any], path: Path, palette: Any = None, **options: Any) -> None:
    """Write pictures to one file with Pillow, in the colours of a palette if there is one."""
    images = (Image.fromarray(picture) for picture in pictures)
    if palette is not None:
        images = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    options |= {"quality": 80, "method": 4} if path.suffix == ".webp" else {"optimize": True}
    if "save_all" in options:
        options["append_images"] = images
    next(images).save(path, **options)


def _palette(pictures: list[Any]) -> Any:
    """Return one palette for all pictures, so that a GIF file stores only what moves.

    Half of the sample are the colours that have a meaning, since they fill few pixels of the pictures.
    """
    shades = [
        blend(colour, other, share) for colour in MEANINGFUL for other in (WHITE, INK) for share in (0.0, 0.25, 0.5)
    ]
    stacked = np.concatenate(pictures)
    height = len(stacked) // (2 * len(shades)) + 1
    swatches = np.repeat(np.array(shades, np.uint8), height, axis=0)[:, np.newaxis]
    sample = np.concatenate([stacked, np.broadcast_to(swatches, (len(swatches), stacked.shape[1], 3))])
    return Image.fromarray(sample).quantize(_PALETTE_SIZE, method=Image.Quantize.MEDIANCUT)
