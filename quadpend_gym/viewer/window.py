"""The window of the render mode ``human``: pictures in real time, and keys."""

import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import pygame
from gymnasium.error import Error

from quadpend_gym.viewer import palette as paint
from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.snapshot import Snapshot

SIZE = (960, 720)
HELP = (
    "space pause   . step   R restart   S F slower faster   arrows mouse orbit   + - zoom   T top   V view   Esc close"
)
_FRAME = 1.0 / 60.0  # s
_TURN, _ZOOM = 0.05, 1.1  # rad and factor of one key press
_DRAG = 0.008  # rad per pixel
_SLOWEST, _FASTEST = 1.0 / 16.0, 4.0


class Controls:
    """What keys and mouse do, for a window of any kind.

    Attributes:
        paused: whether time stands still.
        speed: of the time shown.
        steps: to go although paused.
        over: whether the running episode is to end.
        closed: whether the window is closed, or is to close.
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
        elif key in (pygame.K_s, pygame.K_f):
            self.speed = min(max(self.speed * (0.5 if key == pygame.K_s else 2.0), _SLOWEST), _FASTEST)
        elif key == pygame.K_v:
            vars(self._camera).update(vars(Camera()))
        elif key == pygame.K_h:
            self.help = not self.help
        elif key == pygame.K_r:
            self.over = True
        elif key in (pygame.K_ESCAPE, pygame.K_q):
            self.over = self.closed = True


class Window:
    """A window that shows snapshots as time passes.

    Args:
        period: s, between two snapshots.

    Raises:
        Error: no window can be opened.
    """

    def __init__(self, period: float) -> None:
        """Open the window."""
        self.picture, self._period = Picture(), period
        self._controls = Controls(self.picture)
        self._screen = open_window("QuadPendulum", SIZE)
        self._due = self._drawn = time.perf_counter()

    def asked(self) -> bool:
        """Whether whoever watches wants the running episodes to end; told once."""
        asked, self._controls.over = self._controls.over, False
        return asked

    def show(self, snapshots: Callable[[], Sequence[Snapshot]]) -> None:
        """Show what `snapshots` returns when it is time for it; return when it is time for the next."""
        controls = self._controls
        controls.closed |= not pygame.display.get_init()  # somebody else may have closed pygame's one window
        if controls.closed:
            return
        while not controls.over:
            now = time.perf_counter()
            if now - self._drawn >= _FRAME or now >= self._due:
                for event in pygame.event.get():
                    controls.handle(event)
                if now - self._drawn >= _FRAME or controls.steps:
                    self._draw(snapshots())
                    self._drawn = time.perf_counter()  # so that pictures that take long are left out
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
        self.picture.mosaic(self._screen, snapshots)
        write_state(self._screen, self.picture, self._controls)
        pygame.display.flip()


def open_window(title: str, size: tuple[int, int]) -> Any:
    """A window of pygame, which has one for each process, that can be resized.

    Raises:
        Error: it cannot be opened.
    """
    try:
        pygame.display.init()
        pygame.display.set_caption(title)
        window = pygame.display.set_mode(size, pygame.RESIZABLE)
    except pygame.error as error:
        raise Error(f"no window can be opened ({error}); the render mode 'rgb_array' needs none") from error
    pygame.key.set_repeat(300, 30)
    return window


def unseen() -> bool:
    """Whether the window that is open is one that SDL falls back to without a screen."""
    driver = pygame.display.get_driver()
    return driver in ("dummy", "offscreen") and os.environ.get("SDL_VIDEODRIVER") != driver


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
