"""The command `quadpend watch`: policies side by side in the same episode, in a window or in a file."""

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import tyro

from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_train.cli.options import named_scenarios
from quadpend_train.evaluation.episodes import TEST_SEED

FORMATS = (".mp4", ".gif", ".webp", ".png")
_WINDOW_RATE = 60.0  # pictures per second


@settings
class VideoOptions:
    """Options of the picture and of the video."""

    out: Path | None = None
    """File for a video (.mp4, .gif, .webp) or for its last picture (.png); without it, a window opens."""
    size: tuple[Annotated[int, Range(320, 8000, "pixels")], Annotated[int, Range(180, 8000, "pixels")]] = (1280, 720)
    """Width and height in pixels."""
    fps: Annotated[float, Range(1.0, 100.0, "Hz")] = 25.0
    """Pictures per second of a video. GIF files round the time between pictures to hundredths of a second."""
    speed: Annotated[float, Range(0.05, 20.0)] = 1.0
    """Playback speed; 1 is real time."""
    seconds: Annotated[Interval, Range(0.0, 1e6, "s")] = (0.0, 1e6)
    """Begin and end of the shown part of the episode, s; by default the whole episode."""

    def __post_init__(self) -> None:
        if self.out and self.out.suffix not in FORMATS:
            raise ValueError(f"out must end with one of {', '.join(FORMATS)}, not be {str(self.out)!r}")
        if self.out and self.out.suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
            raise ValueError("MP4 files need imageio-ffmpeg: pip install 'quadpend-gym[view]'")


_DEFAULT = VideoOptions()


def watch(
    policies: tyro.conf.Positional[tuple[str, ...]] = ("adrc-paper", "apg-0"),
    scenarios: tuple[str, ...] = ("windy",),
    seed: int = TEST_SEED,
    video: Annotated[VideoOptions, tyro.conf.arg(name="")] = _DEFAULT,
    vehicle: str | None = None,
    interface: str | None = None,
) -> None:
    """Show up to four policies side by side in the same episode, or one policy in up to four scenarios.

    Args:
        policies: Policies, as in evaluate; NAME=POLICY gives a policy a name.
        scenarios: Names, TOML or JSON files, or JSON, as in evaluate, with the same control period.
        seed: Seed of the episode.
        video: Options of the picture and of the video.
        vehicle: Vehicle of the scenario, as in evaluate.
        interface: What the actions command in the scenario: wrench, rotors or body_rates.
    """
    from quadpend_gym.viewer import check_pygame
    from quadpend_train.evaluation.comparison import named_policies
    from quadpend_train.policies.loading import check_policy, load_policies

    chosen = named_scenarios(scenarios, vehicle, interface)
    if not 1 <= len(policies) * len(chosen) <= 4 or min(len(policies), len(chosen)) > 1:
        raise ValueError(
            "watch shows one to four policies in one scenario, or one policy in up to four scenarios, not"
            f" {len(policies)} policies in {len(chosen)} scenarios: {', '.join(chosen)}"
        )
    periods = {scenario.simulation.period for scenario in chosen.values()}
    if len(periods) > 1:
        raise ValueError(f"scenarios must have the same control period, not {', '.join(map(str, sorted(periods)))} s")
    check_pygame()
    if video.out:
        video.out.parent.mkdir(parents=True, exist_ok=True)
    from quadpend_gym.viewer.window import is_headless, open_window
    from quadpend_train.evaluation.recording import record_episode
    from quadpend_train.reports.side_by_side import SideBySideView, write_video

    loaded = [(name, load_policies(str(policy))) for name, policy in named_policies(policies).items()]
    if several := [name for name, seeds in loaded if len(seeds) > 1]:
        raise ValueError(f"{several[0]} has several training seeds: choose one of them")
    flights = [(*pair, *item) for pair in loaded for item in chosen.items()]
    for name, seeds, shown, found in flights:
        check_policy(name, seeds[0], shown, found)
    if video.out is None:
        screen = open_window("quadpend watch", video.size)
        if is_headless():
            raise ValueError("there is no screen for a window: give --out, a file for the video")
    (period,) = periods
    recordings = [
        record_episode(name if len(chosen) == 1 else shown, seeds[0], found, seed)
        for name, seeds, shown, found in flights
    ]
    view = SideBySideView(recordings, period, video.seconds)
    if video.out is None:
        _play(view, screen, period, video.speed)
        return
    write_video(view, video.out, video.size, video.fps, video.speed / period)
    print(f"Written: {video.out}")


def _play(view: Any, screen: Any, period: float, speed: float) -> None:
    """Show the view in a window until the user closes it."""
    import pygame

    from quadpend_gym.viewer.window import Controls

    controls, position, before = Controls(view.picture), float(view.steps.start), time.perf_counter()  # in steps; s
    while True:
        for event in pygame.event.get():
            controls.handle(event)
        if controls.closed:
            break
        now = time.perf_counter()
        if not controls.paused:
            position = min(position + speed * (now - before) / period, float(view.steps.stop - 1))
        before = now
        view.draw(screen, int(position))
        pygame.display.flip()
        time.sleep(max(1.0 / _WINDOW_RATE - (time.perf_counter() - now), 0.0))
    pygame.display.quit()
