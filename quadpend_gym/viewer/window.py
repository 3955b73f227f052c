"""The window of the render mode ``human``: pictures in real time, with keys and mouse."""

import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import pygame
from gymnasium.error import Error

from quadpend_gym.viewer import palette
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.primitives import write
from quadpend_gym.viewer.snapshot import Snapshot

SIZE = (960, 720)
HELP = "space pause   . step   R restart   S F slower faster   arrows mouse orbit   + - zoom   Esc close"
_FRAME_TIME = 1.0 / 60.0  # s
_ORBIT_STEP, _ZOOM_STEP = 0.05, 1.1  # rad and factor of one key press
_ORBIT_PER_PIXEL = 0.008  # rad
_MIN_SPEED, _MAX_SPEED = 1.0 / 16.0, 4.0


class Controls:
    """The state of a window that keys and mouse change, and its camera."""

    def __init__(self, picture: Picture) -> None:
        self._camera = picture.camera
        self._orbit_keys = {
            pygame.K_LEFT: (-_ORBIT_STEP, 0.0),
            pygame.K_RIGHT: (_ORBIT_STEP, 0.0),
            pygame.K_UP: (0.0, _ORBIT_STEP),
            pygame.K_DOWN: (0.0, -_ORBIT_STEP),
        }
        self.paused, self.help = False, False  # help: whether the list of keys is shown
        self.speed, self.steps = 1.0, 0  # 1 is real time; number of single steps still to make while paused
        self.end_requested = False  # of the running episode
        self.closed = False  # whether the window is or is to be closed

    def handle(self, event: Any) -> None:
        """Respond to an event of pygame."""
        if event.type == pygame.QUIT:
            self.end_requested = self.closed = True
        elif event.type == pygame.KEYDOWN:
            self._press(event.key)
        elif event.type == pygame.MOUSEMOTION and event.buttons[0]:
            self._camera.orbit(-_ORBIT_PER_PIXEL * event.rel[0], _ORBIT_PER_PIXEL * event.rel[1])
        elif event.type == pygame.MOUSEWHEEL:
            self._camera.zoom(_ZOOM_STEP**-event.y)

    def _press(self, key: int) -> None:
        if key in self._orbit_keys:
            self._camera.orbit(*self._orbit_keys[key])
        elif key in (pygame.K_PLUS, pygame.K_EQUALS, pygame.K_KP_PLUS):
            self._camera.zoom(1.0 / _ZOOM_STEP)
        elif key in (pygame.K_MINUS, pygame.K_KP_MINUS):
            self._camera.zoom(_ZOOM_STEP)
        elif key == pygame.K_SPACE:
            self.paused = not self.paused
        elif key == pygame.K_PERIOD:
            self.paused, self.steps = True, self.steps + 1
        elif key in (pygame.K_s, pygame.K_f):
            self.speed = min(max(self.speed * (0.5 if key == pygame.K_s else 2.0), _MIN_SPEED), _MAX_SPEED)
        elif key == pygame.K_h:
            self.help = not self.help
        elif key == pygame.K_r:
            self.end_requested = True
        elif key in (pygame.K_ESCAPE, pygame.K_q):
            self.end_requested = self.closed = True


class Window:
    """A window that shows snapshots in real time, one in every `period` (s)."""

    def __init__(self, period: float) -> None:
        self.picture, self._period = Picture(), period
        self._controls = Controls(self.picture)
        self._screen = open_window("QuadPendulum", SIZE)
        self._due = self._drawn = time.perf_counter()

    def pop_end_request(self) -> bool:
        """Return whether the user has asked to end the running episodes, and clear this request."""
        requested, self._controls.end_requested = self._controls.end_requested, False
        return requested

    def show(self, snapshots: Callable[[], Sequence[Snapshot]]) -> None:
        """Show the current snapshots, which are made only if a picture is drawn, and wait until the next are due."""
        controls = self._controls
        controls.closed |= not pygame.display.get_init()  # other code may have closed pygame's one window
        if controls.closed:
            return
        while not controls.end_requested:
            now = time.perf_counter()
            if now - self._drawn >= _FRAME_TIME or now >= self._due:
                for event in pygame.event.get():
                    controls.handle(event)
                if now - self._drawn >= _FRAME_TIME or controls.steps:
                    self._draw(snapshots())
                    self._drawn = time.perf_counter()  # after drawing, so that slow pictures are skipped
            if controls.steps:
                controls.steps -= 1
                break
            if not controls.paused and now >= self._due:
                break
            time.sleep(min(max(self._due - now, 0.001), 0.005))
        if controls.closed:
            self.close()
        late = time.perf_counter() - self._due
        self._due += self._period / controls.speed if late < 0.1 else late

    def close(self) -> None:
        """Close the window."""
        self._controls.closed = True
        pygame.display.quit()

    def _draw(self, snapshots: Sequence[Snapshot]) -> None:
        self.picture.draw_mosaic(self._screen, snapshots)
        draw_status(self._screen, self._controls)
        pygame.display.flip()


def open_window(title: str, size: tuple[int, int]) -> Any:
    """Open a resizable window and return its surface. Pygame has one window per process."""
    try:
        pygame.display.init()
        pygame.display.set_caption(title)
        window = pygame.display.set_mode(size, pygame.RESIZABLE)
    except pygame.error as error:
        raise Error(f"no window can be opened ({error}); the render mode 'rgb_array' needs none") from error
    pygame.key.set_repeat(300, 30)
    return window


def is_headless() -> bool:
    """Return whether SDL has fallen back to a driver without a screen that the user did not ask for."""
    driver = pygame.display.get_driver()
    return driver in ("dummy", "offscreen") and os.environ.get("SDL_VIDEODRIVER") != driver


def draw_status(surface: Any, controls: Controls) -> None:
    """Write the playback speed and the keys along the lower edge of a window."""
    width, height = surface.get_size()
    parts = ["paused"] if controls.paused else []
    parts += [f"{controls.speed:g} × time"] if controls.speed != 1.0 else []
    parts += [HELP] if controls.help or controls.paused else ["H help"]
    text = "   ".join(parts)
    size = 20 if len(text) < 20 else max(min(20, round(2.4 * width / len(text))), 10)
    background = pygame.Surface((width, size + 8))
    background.fill(palette.WHITE)
    background.set_alpha(150 if len(parts) > 1 else 0)
    surface.blit(background, (0, height - size - 8))
    write(surface, text, (width / 2, height - 5), size, palette.INK, "midbottom")
