"""The window of the render mode ``human``: pictures in real time."""

import os
import time
from collections.abc import Callable
from typing import Any

import pygame
from gymnasium.error import Error

from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.snapshot import Snapshot

SIZE = (960, 720)
_FRAME_TIME = 1.0 / 60.0  # s
_ORBIT_PER_PIXEL, _ZOOM_STEP = 0.008, 1.1  # rad, and factor of a step of the wheel


class Controls:
    """What keys and mouse change in a window: space pauses, the mouse turns the camera, Esc closes."""

    def __init__(self, picture: Picture) -> None:
        self._camera = picture.camera
        self.paused = self.closed = False  # closed: whether the window is or is to be closed

    def handle(self, event: Any) -> None:
        """Respond to an event of pygame."""
        if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
            self.closed = True
        elif event.type == pygame.KEYDOWN and event.key == pygame.K_SPACE:
            self.paused = not self.paused
        elif event.type == pygame.MOUSEMOTION and event.buttons[0]:
            self._camera.orbit(-_ORBIT_PER_PIXEL * event.rel[0], _ORBIT_PER_PIXEL * event.rel[1])
        elif event.type == pygame.MOUSEWHEEL:
            self._camera.zoom(_ZOOM_STEP**-event.y)


class Window:
    """A window that shows snapshots in real time, one in every `period` (s)."""

    def __init__(self, period: float) -> None:
        self.picture, self._period = Picture(), period
        self._controls, self._end_requested = Controls(self.picture), False
        self._screen = open_window("QuadPendulum", SIZE)
        self._due = self._drawn = time.perf_counter()

    def pop_end_request(self) -> bool:
        """Return whether the user has closed the window since the last call."""
        requested, self._end_requested = self._end_requested, False
        return requested

    def show(self, snapshot: Callable[[], Snapshot]) -> None:
        """Show the current snapshot, which is made only if a picture is drawn, and wait until the next one is due."""
        controls = self._controls
        controls.closed |= not pygame.display.get_init()  # other code may have closed pygame's one window
        if controls.closed:
            return
        while not controls.closed:
            now = time.perf_counter()
            if now - self._drawn >= _FRAME_TIME or now >= self._due:
                for event in pygame.event.get():
                    controls.handle(event)
                if now - self._drawn >= _FRAME_TIME:
                    self.picture.draw(self._screen, snapshot())
                    pygame.display.flip()
                    self._drawn = time.perf_counter()  # after drawing, so that slow pictures are skipped
            if not controls.paused and now >= self._due:
                break
            time.sleep(min(max(self._due - now, 0.001), 0.005))
        if controls.closed:
            self._end_requested = True
            self.close()
        late = time.perf_counter() - self._due
        self._due += self._period if late < 0.1 else late

    def close(self) -> None:
        """Close the window."""
        self._controls.closed = True
        pygame.display.quit()


def open_window(title: str, size: tuple[int, int]) -> Any:
    """Open a resizable window and return its surface. Pygame has one window per process."""
    try:
        pygame.display.init()
        pygame.display.set_caption(title)
        window = pygame.display.set_mode(size, pygame.RESIZABLE)
    except pygame.error as error:
        raise Error(f"no window can be opened ({error}); the render mode 'rgb_array' needs none") from error
    return window


def is_headless() -> bool:
    """Return whether SDL has fallen back to a driver without a screen that the user did not ask for."""
    driver = pygame.display.get_driver()
    return driver in ("dummy", "offscreen") and os.environ.get("SDL_VIDEODRIVER") != driver
