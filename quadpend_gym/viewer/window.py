"""The window of the render mode ``human``: pictures in real time, and keys."""

import os
import time
from collections.abc import Sequence
from typing import Any

import pygame
from gymnasium.error import Error

from quadpend_gym.film import Snapshot
from quadpend_gym.viewer import palette as paint
from quadpend_gym.viewer.picture import Picture

SIZE = (960, 720)
HELP = "space pause   . step   R restart   [ ] speed   arrows or mouse orbit   + - zoom   T top   H help   Esc close"
_FRAME = 1.0 / 60.0  # s
_TURN, _ZOOM = 0.05, 1.1  # rad and factor of one key press
_DRAG = 0.008  # rad per pixel
_UNSEEN = ("dummy", "offscreen")  # what SDL falls back to without a screen
_SLOWEST, _FASTEST = 1.0 / 16.0, 4.0


class Controls:
    """What keys and mouse do, for a window of any kind.

    Attributes:
        paused: whether time stands still.
        speed: of the time shown.
        steps: to go although paused.
        over: whether the episode is to end.
        closed: whether the window is to close.
        help: whether the keys are shown.
    """

    def __init__(self, picture: Picture) -> None:
        """Everything as at the beginning."""
        self._camera = picture.camera
        self._turns = {
            pygame.K_LEFT: (-_TURN, 0.0),
            pygame.K_RIGHT: (_TURN, 0.0),
            pygame.K_UP: (0.0, _TURN),
            pygame.K_DOWN: (0.0, -_TURN),
            pygame.K_t: (0.0, 2.0),
        }
        self.paused, self.speed, self.steps, self.over, self.closed, self.help = False, 1.0, 0, False, False, False

    def handle(self, event: Any) -> None:
        """Do what an event asks for."""
        if event.type == pygame.QUIT:
            self.over = self.closed = True
        elif event.type == pygame.KEYDOWN:
            self._press(event.key)
        elif event.type == pygame.MOUSEMOTION and event.buttons[0]:
            self._camera.orbit(-_DRAG * event.rel[0], _DRAG * event.rel[1])
        elif event.type == pygame.MOUSEWHEEL:
            self._camera.zoom(_ZOOM**-event.y)

    def _press(self, key: int) -> None:
        if key in self._turns:
            self._camera.orbit(*self._turns[key])
        elif key in (pygame.K_PLUS, pygame.K_EQUALS, pygame.K_KP_PLUS):
            self._camera.zoom(1.0 / _ZOOM)
        elif key in (pygame.K_MINUS, pygame.K_KP_MINUS):
            self._camera.zoom(_ZOOM)
        elif key == pygame.K_SPACE:
            self.paused = not self.paused
        elif key == pygame.K_PERIOD:
            self.paused, self.steps = True, self.steps + 1
        elif key in (pygame.K_LEFTBRACKET, pygame.K_RIGHTBRACKET):
            factor = 0.5 if key == pygame.K_LEFTBRACKET else 2.0
            self.speed = min(max(self.speed * factor, _SLOWEST), _FASTEST)
        elif key == pygame.K_h:
            self.help = not self.help
        elif key == pygame.K_r:
            self.over = True
        elif key in (pygame.K_ESCAPE, pygame.K_q):
            self.over = self.closed = True


class Window:
    """A window that shows snapshots as time passes.

    Args:
        picture: draws them.
        period: s, between two snapshots.

    Raises:
        Error: no window can be opened.
    """

    def __init__(self, picture: Picture, period: float) -> None:
        """Open the window."""
        self._picture, self._period = picture, period
        self._controls = Controls(picture)
        self._screen = open_window("QuadPendulum", SIZE)
        self._due = self._drawn = time.perf_counter()

    @property
    def over(self) -> bool:
        """Whether whoever watches wants the episode to end; for good once the window is closed."""
        return self._controls.over

    @property
    def closed(self) -> bool:
        """Whether the window is closed for good."""
        return self._controls.closed

    def show(self, snapshots: Sequence[Snapshot]) -> None:
        """Show the snapshots when it is time for them; return when it is time for the next."""
        controls = self._controls
        if controls.closed:
            return
        controls.over = False
        while True:
            now = time.perf_counter()
            waiting = controls.paused and not controls.steps
            if now - self._drawn >= _FRAME or now >= self._due:
                for event in pygame.event.get():
                    controls.handle(event)
                if now - self._drawn >= _FRAME or controls.steps:
                    self._draw(snapshots)
                    self._drawn = time.perf_counter()  # so that pictures that take long are left out
            if controls.over:
                if controls.closed:
                    self.close()
                return
            if controls.steps:
                controls.steps -= 1
                break
            if not waiting and now >= self._due:
                break
            time.sleep(min(max(self._due - now, 0.001), 0.005))
        late = time.perf_counter() - self._due
        self._due += self._period / controls.speed if late < 0.1 else late

    def close(self) -> None:
        """Close the window."""
        self._controls.closed = True
        pygame.display.quit()

    def _draw(self, snapshots: Sequence[Snapshot]) -> None:
        screen, controls = self._screen, self._controls
        self._picture.mosaic(screen, snapshots)
        write_state(screen, self._picture, controls)
        pygame.display.flip()


def open_window(title: str, size: tuple[int, int]) -> Any:
    """A window of pygame that can be resized.

    Raises:
        Error: there is no screen.
    """
    try:
        pygame.display.init()
        pygame.display.set_caption(title)
        window = pygame.display.set_mode(size, pygame.RESIZABLE)
    except pygame.error as error:
        raise Error(f"no window can be opened ({error}); the render mode 'rgb_array' needs none") from error
    driver = pygame.display.get_driver()
    if driver in _UNSEEN and os.environ.get("SDL_VIDEODRIVER") != driver:
        pygame.display.quit()
        raise Error("no window can be opened (there is no screen); the render mode 'rgb_array' needs none")
    return window


def write_state(surface: Any, picture: Picture, controls: Controls) -> None:
    """Write into a window's lower edge what the keys are, and whether time is slowed or stopped."""
    width, height = surface.get_size()
    shown = ["paused"] if controls.paused else []
    shown += [f"{controls.speed:g} × time"] if controls.speed != 1.0 else []
    shown += [HELP] if controls.help or controls.paused else ["H help"]
    text = "   ".join(shown)
    size = 20 if len(text) < 20 else max(min(20, round(2.4 * width / len(text))), 10)
    veil = pygame.Surface((width, size + 8))
    veil.fill(paint.PAPER)
    veil.set_alpha(150 if len(shown) > 1 else 0)
    surface.blit(veil, (0, height - size - 8))
    picture.letters.write(surface, text, (width / 2, height - 5), size, paint.INK, "midbottom")
