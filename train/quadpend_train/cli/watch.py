"""`quadpend watch`: policies in the same episode side by side, in a window or in a file."""

import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import tyro

from quadpend_train.cli import commands
from quadpend_train.evaluation.episodes import VALIDATION_SEED

FORMATS = (".mp4", ".gif", ".webp", ".png")
_WINDOW_RATE = 60.0  # pictures per second


def watch(
    policies: tyro.conf.Positional[tuple[str, ...]] = ("adrc-paper", "ppo-gain-scheduling-0"),
    scenario: str = "windy",
    seed: int = VALIDATION_SEED,
    out: Path | None = None,
    size: tuple[int, int] = (1280, 720),
    fps: float = 25.0,
    speed: float = 1.0,
    seconds: tuple[float, float] = (0.0, 10.0),
    zoom: float = 1.0,
) -> None:
    """Watch policies fly the same episode side by side, above their errors and the wind as they saw it.

    Args:
        policies: One to three, as in evaluate; NAME=POLICY gives one a name.
        scenario: By name, TOML or JSON file, or as JSON, as in evaluate.
        seed: Of the episode.
        out: File for a film (.mp4, .gif, .webp) or a picture of its end (.png), instead of a window.
        size: Width and height, in pixels.
        fps: Pictures per second of a film; GIF counts hundredths of a second.
        speed: Of the time shown.
        seconds: From when to when to show.
        zoom: How much closer than usual.
    """
    from quadpend_gym.viewer import check_pygame
    from quadpend_train.policies.loading import load_policies
    from quadpend_train.scenarios import find_scenario

    _check(policies, out, size, fps, speed, seconds, zoom)
    check_pygame()
    from quadpend_train.evaluation.recording import record_episode
    from quadpend_train.reports.side_by_side import SideBySideView

    found = find_scenario(scenario)
    loaded = [(name, load_policies(policy)) for name, policy in commands.named_policies(policies).items()]
    if several := [name for name, members in loaded if len(members) > 1]:
        raise ValueError(f"{several[0]} has several training seeds: choose one of them")
    screen = _open(size) if out is None else None
    period = found.simulation.period
    board = SideBySideView([record_episode(name, members[0], found, seed) for name, members in loaded], period, seconds)
    board.picture.camera.zoom(1.0 / zoom)
    if out is None:
        _play(board, screen, period, speed)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    _film(board, out, size, fps, speed / period)
    print(f"Written: {out}")


def _check(
    policies: tuple[str, ...],
    out: Path | None,
    size: tuple[int, int],
    fps: float,
    speed: float,
    seconds: tuple[float, float],
    zoom: float,
) -> None:
    if not 1 <= len(policies) <= 3:
        raise ValueError(f"one to three policies can be watched at a time, not {len(policies)}")
    if not (320 <= size[0] <= 8000 and 180 <= size[1] <= 8000):
        raise ValueError(f"size must be from 320 × 180 to 8000 × 8000 pixels, not {size[0]} × {size[1]}")
    if not 1.0 <= fps <= 100.0:
        raise ValueError(f"fps must be from 1 to 100, not {fps:g}")
    if not 0.05 <= speed <= 20.0:
        raise ValueError(f"speed must be from 0.05 to 20, not {speed:g}")
    if not 0.2 <= zoom <= 2.5:
        raise ValueError(f"zoom must be from 0.2 to 2.5, not {zoom:g}")
    if not 0.0 <= seconds[0] < seconds[1]:
        raise ValueError(
            f"seconds must be a beginning of at least 0 and a later end, not {seconds[0]:g} {seconds[1]:g}"
        )
    if out is not None and out.suffix not in FORMATS:
        raise ValueError(f"out must end with one of {', '.join(FORMATS)}, not be {str(out)!r}")
    if out is not None and out.suffix == ".gif" and fps > 50.0:
        raise ValueError(f"browsers slow GIF films down that have more than 50 pictures per second: fps is {fps:g}")
    if out is not None and out.suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise ValueError("MP4 films need imageio-ffmpeg: pip install 'quadpend-gym[view]'")
    if out is not None and out.suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise ValueError(f"an MP4 film has an even number of pixels each way, not {size[0]} × {size[1]}")


def _open(size: tuple[int, int]) -> Any:
    from quadpend_gym.viewer.window import is_headless, open_window

    screen = open_window("quadpend watch", size)
    if is_headless():
        raise ValueError("there is no screen for a window: give --out, a file for the film")
    return screen


def _play(board: Any, screen: Any, period: float, speed: float) -> None:
    """Show the board in a window until it is closed."""
    import pygame

    from quadpend_gym.viewer.window import Controls, draw_status

    controls = Controls(board.picture)
    controls.speed = speed
    first, last = float(board.steps.start), float(board.steps.stop - 1)
    at, before = first, time.perf_counter()
    while True:
        for event in pygame.event.get():
            controls.handle(event)
        if controls.closed:
            break
        now = time.perf_counter()
        if controls.end_requested:
            controls.end_requested, at = False, first
        if controls.steps:
            at, controls.steps = at + controls.steps, 0
        elif not controls.paused:
            at += controls.speed * (now - before) / period
        at, before = min(at, last), now
        board.draw(screen, int(at))
        draw_status(screen, board.picture, controls)
        pygame.display.flip()
        time.sleep(max(1.0 / _WINDOW_RATE - (time.perf_counter() - now), 0.0))
    pygame.display.quit()


def _pictures(board: Any, size: tuple[int, int], steps: list[int]) -> Iterator[Any]:
    """What the board shows after each of these steps, shape (height, width, 3), uint8."""
    import pygame
    from tqdm import tqdm

    from quadpend_gym.viewer.picture import surface_to_array

    surface = pygame.Surface(size)
    for step in tqdm(steps, desc="drawing", disable=None if len(steps) > 1 else True):
        board.draw(surface, step)
        yield surface_to_array(surface)


def _film(board: Any, out: Path, size: tuple[int, int], fps: float, rate: float) -> None:
    """Write a film of `rate` steps per second, or the last picture; an interruption leaves what was there."""
    import numpy as np

    shown = board.steps
    seconds = round(100.0 / fps) / 100.0 if out.suffix == ".gif" else 1.0 / fps  # GIF counts hundredths
    steps = np.arange(shown.start, shown.stop, rate * seconds).astype(int).tolist()
    unfinished = out.with_name(f"{out.stem}.unfinished{out.suffix}")
    try:
        if out.suffix == ".mp4":
            from imageio.v2 import get_writer

            with get_writer(unfinished, fps=fps, quality=8, macro_block_size=2) as writer:
                for picture in _pictures(board, size, steps):
                    writer.append_data(picture)  # type: ignore[attr-defined]
        elif out.suffix == ".png":
            _write_images(_pictures(board, size, [shown.stop - 1]), unfinished)
        else:
            few = steps[:: max(len(steps) // 4, 1)]
            palette = _palette(list(_pictures(board, size, few))) if out.suffix == ".gif" else None
            images = _pictures(board, size, steps)
            more = {"save_all": True, "duration": 1000.0 * seconds, "loop": 0}
            _write_images(images, unfinished, palette, **more)
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)


def _write_images(pictures: Iterator[Any], path: Path, palette: Any = None, **more: Any) -> None:
    """Write pictures as one file, in the colours of a palette if there is one."""
    from PIL import Image

    plain = (Image.fromarray(picture) for picture in pictures)
    images = (
        plain if palette is None else (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in plain)
    )
    more |= {"quality": 80, "method": 4} if path.suffix == ".webp" else {"optimize": True}
    if "save_all" in more:
        more["append_images"] = images
    next(images).save(path, **more)


def _palette(pictures: list[Any]) -> Any:
    """One palette for all, so that only what moves is written; it has the telling colours, though they are rare."""
    import numpy as np
    from PIL import Image

    from quadpend_gym.viewer.palette import INK, MEANINGFUL, WHITE, blend

    shades = [
        blend(colour, other, share) for colour in MEANINGFUL for other in (WHITE, INK) for share in (0.0, 0.25, 0.5)
    ]
    few = np.concatenate(pictures)
    rows = len(few) // (2 * len(shades)) + 1
    swatches = np.repeat(np.array(shades, np.uint8), rows, axis=0)[:, np.newaxis]
    sample = np.concatenate([few, np.broadcast_to(swatches, (len(swatches), few.shape[1], 3))])
    return Image.fromarray(sample).quantize(192, method=Image.Quantize.MEDIANCUT)
