"""`quadpend watch` shows policies side by side in the same episode, in a window or in a file."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pygame
import pytest
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image

from quadpend_train.cli.watch import VideoOptions, watch
from quadpend_train.reports.side_by_side import SideBySideView
from tests.helpers.bad_input import assert_refused

SEED = 3_000_000
SIZE = (320, 180)
WINDY = '{"wind": "windy", "duration": 2.5}'
CALM = '{"duration": 2.0}'


@pytest.mark.parametrize("ending", [".mp4", ".gif", ".webp"])
def test_a_video_shows_the_requested_part_at_the_requested_speed(ending: str, tmp_path: Path) -> None:
    out = tmp_path / f"new/video{ending}"
    watch(("flatness",), (WINDY,), SEED, VideoOptions(out, SIZE, fps=20.0, speed=0.5, seconds=(1.0, 1.5)))
    if ending == ".mp4":
        assert count_frames_and_secs(out) == (20, 1.0)
    else:
        with Image.open(out) as video:
            assert video.size == SIZE
            assert video.n_frames == 20
            video.load()
            assert video.info["duration"] == 50
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_one_policy_flies_several_vehicles_side_by_side(tmp_path: Path) -> None:
    scenarios = tuple(f"flight_breeze@{vehicle}" for vehicle in ("hummingbird", "crazyflie"))
    watch(("lqg",), scenarios, SEED, VideoOptions(tmp_path / "two.png", SIZE, seconds=(0.0, 0.2)))
    with Image.open(tmp_path / "two.png") as picture:
        assert picture.size == SIZE


def test_the_window_plays_to_the_end_and_waits_until_it_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame.display.quit()  # another test may have opened a display with another driver
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown: list[int] = []
    press: dict[int, Callable[[], Any]] = {
        3: lambda: pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_SPACE)),
        6: lambda: pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_SPACE)),
        40: lambda: pygame.event.post(pygame.event.Event(pygame.QUIT)),
    }
    draw = SideBySideView.draw

    def drawing(self: SideBySideView, surface: Any, step: int) -> None:
        shown.append(step)
        draw(self, surface, step)
        press.get(len(shown), lambda: None)()

    clock = SimpleNamespace(
        perf_counter=lambda: len(shown) / 60.0, sleep=lambda seconds: None
    )  # 60 pictures per second
    monkeypatch.setattr("quadpend_train.cli.watch.time", clock)
    monkeypatch.setattr(SideBySideView, "draw", drawing)
    watch(("flatness",), (CALM,), SEED, VideoOptions(size=SIZE, speed=4.0, seconds=(0.0, 0.5)))
    assert not pygame.display.get_init()
    assert shown[3] == shown[5] < shown[-1], "paused"
    assert shown[-1] == 49, "the end"


def test_a_window_without_a_screen_is_an_error_before_any_episode_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")
    monkeypatch.setattr("quadpend_train.evaluation.recording.record_episode", lambda *_: pytest.fail("an episode ran"))
    assert_refused(lambda: watch(("flatness",)), "there is no screen for a window: give --out", ValueError)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"policies": ()}, "not 0 policies in 1 scenarios"),
        ({"policies": ("lqr", "lqg"), "scenarios": ("calm", "windy")}, "not 2 policies in 2 scenarios: calm, windy"),
        ({"scenarios": ("calm", "as_flown")}, "must have the same control period, not 0.01, 0.02 s"),
        ({"out": Path("video.avi")}, r"\.mp4, \.gif, \.webp, \.png, not be 'video.avi'"),
        ({"seconds": (3.0, 2.0)}, r"the numbers must be in the order \(lowest, highest\), not \(3.0, 2.0\)"),
        (
            {"policies": ("adrc-paper",), "scenarios": ("lagged",), "seconds": (5.0, 6.0)},
            "an episode of 0.* has no step between 5 and 6 s",
        ),
    ],
)
def test_wrong_options_are_errors(options: dict[str, Any], message: str) -> None:
    chosen = {name: options[name] for name in ("policies", "scenarios") if name in options}
    video = {name: value for name, value in options.items() if name not in chosen}

    def call() -> None:
        watch(**{"policies": ("flatness",), **chosen}, video=VideoOptions(**{"out": Path("video.gif"), **video}))

    assert_refused(call, message, ValueError)
