"""The window of the render mode ``human`` with a simulated clock, and the behaviour without pygame."""

import dataclasses
import sys
from typing import Any

import numpy as np
import pygame
import pytest
from gymnasium.error import DependencyNotInstalled, Error

from quadpend_gym.viewer import window
from tests.helpers.envs import ENDLESS, make, make_unwrapped

ZERO = np.zeros(4, np.float32)


class Clock:
    """A replacement of the module `time` that advances only in `sleep`, and posts events."""

    def __init__(self) -> None:
        self.now = 0.0
        self.shown: list[float] = []  # times of the pictures
        self._events: list[tuple[float, Any]] = []

    def post(self, at: float, event: Any) -> None:
        """Post an event, or press a key, at a time in s from now."""
        event = pygame.event.Event(pygame.KEYDOWN, key=event) if isinstance(event, int) else event
        self._events.append((self.now + at, event))

    def perf_counter(self) -> float:
        assert self.now < 100.0, "the window waits forever"
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def events(self) -> list[Any]:
        come = [event for time, event in self._events if time <= self.now]
        self._events = [(time, event) for time, event in self._events if time > self.now]
        return come

    def flip(self) -> None:
        self.shown.append(self.now)


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch: pytest.MonkeyPatch) -> Any:
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(window, "time", clock)
    monkeypatch.setattr(pygame.event, "get", clock.events)
    monkeypatch.setattr(pygame.display, "flip", clock.flip)
    return clock


@pytest.fixture
def env(clock: Clock) -> Any:
    """An environment with a window and endless episodes."""
    env = make_unwrapped(render_mode="human", task=ENDLESS)
    env.reset(seed=0)
    yield env
    env.close()


def run_steps(env: Any, steps: int) -> float:
    """Step without an end, and return how long that takes by the clock, s."""
    begin = window.time.perf_counter()
    for _ in range(steps):
        assert not env.step(ZERO)[3]
    return float(window.time.perf_counter() - begin)


def test_playback_is_in_real_time(env: Any, clock: Clock) -> None:
    assert run_steps(env, 30) == pytest.approx(0.3, abs=0.015)
    assert 0.25 * 50 < len(clock.shown) <= 0.3 * 61 + 2


def test_space_pauses_and_resumes(env: Any, clock: Clock) -> None:
    clock.post(0.05, pygame.K_SPACE)
    clock.post(1.05, pygame.K_SPACE)
    assert run_steps(env, 30) == pytest.approx(1.3, abs=0.05)
    assert len(clock.shown) > 50, "a paused window must be drawn, because the camera can move"


def test_the_mouse_moves_the_camera(env: Any, clock: Clock) -> None:
    camera = env.recorder._window.picture.camera

    def after(event: Any) -> tuple[float, float, float]:
        before = dataclasses.replace(camera)
        clock.post(0.0, event)
        run_steps(env, 3)
        rotation = camera.azimuth - before.azimuth, camera.elevation - before.elevation
        return *rotation, camera.distance / before.distance

    assert after(pygame.event.Event(pygame.MOUSEWHEEL, y=1))[2] < 1
    drag = {"rel": (10, 5), "pos": (0, 0)}
    assert after(pygame.event.Event(pygame.MOUSEMOTION, buttons=(0, 0, 0), **drag)) == (0.0, 0.0, 1.0)
    azimuth, elevation, _ = after(pygame.event.Event(pygame.MOUSEMOTION, buttons=(1, 0, 0), **drag))
    assert azimuth < 0 < elevation


@pytest.mark.parametrize(
    "event", [pygame.event.Event(pygame.QUIT), pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE)]
)
def test_closing_the_window_truncates_the_episode_and_the_next_ones_run_without_window(
    env: Any, clock: Clock, event: Any
) -> None:
    clock.post(0.0, event)
    assert any(env.step(ZERO)[3] for _ in range(3))
    assert not pygame.display.get_init()
    env.reset()
    assert run_steps(env, 20) == 0.0
    assert not env.step(ZERO)[3]
    assert not pygame.display.get_init()
    env.close()
    env.close()
    env.reset()
    assert pygame.display.get_init()
    run_steps(env, 5)


def test_the_error_without_a_screen_names_rgb_array(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "nonsense")
    env = make(render_mode="human")
    with pytest.raises(Error, match="rgb_array") as caught:
        env.reset(seed=0)
    assert "\n" not in str(caught.value)
    env.close()


def test_the_first_picture_without_pygame_raises_an_error_that_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    monkeypatch.setitem(sys.modules, "pygame.draw", None)
    with pytest.raises(DependencyNotInstalled, match=r"pygame-ce.*quadpend-gym\[view\]"):
        env.render()
