"""A picture of one snapshot, or of many side by side."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pygame

from quadpend_gym.core.arrays import Bytes
from quadpend_gym.viewer import hud, scene
from quadpend_gym.viewer import palette as paint
from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.palette import Colour
from quadpend_gym.viewer.snapshot import Snapshot
from quadpend_gym.viewer.text import TextRenderer

SIZE = (640, 480)
_BELOW = 0.24  # of the distance, below the vehicle one looks, so that its shadow is in the picture


class Picture:
    """Draws snapshots onto pygame surfaces, with one camera for all of them.

    Attributes:
        camera: where one looks from; change it as you like.
    """

    def __init__(self, camera: Camera | None = None) -> None:
        """Nothing is drawn yet."""
        self.camera = camera or Camera()
        self.letters = TextRenderer()
        self._backdrop, self._surface = scene.Backdrop(), pygame.Surface(SIZE)

    def draw(self, surface: Any, seen: Snapshot, title: str = "", colour: Colour = paint.BOB) -> None:
        """Draw a snapshot over the whole of a surface.

        Args:
            surface: of pygame.
            seen: what is to be seen.
            title: to stand in the corner.
            colour: of the bob, its trail and the title.
        """
        middle = seen.focus - np.array([0.0, 0.0, _BELOW * self.camera.distance * np.cos(self.camera.elevation)])
        view = self.camera.look(middle, *surface.get_size())
        scene.draw(surface, view, self._backdrop, seen, colour)
        hud.draw(surface, view, self.letters, seen, title, colour)

    def mosaic(self, surface: Any, snapshots: Sequence[Snapshot]) -> None:
        """Draw snapshots side by side; a single one has all of the surface."""
        width, height = surface.get_size()
        columns = int(np.ceil(np.sqrt(len(snapshots))))
        rows = -(-len(snapshots) // columns)
        surface.fill(paint.INK)
        for i, seen in enumerate(snapshots):
            left, right = (width * (i % columns + k) // columns for k in (0, 1))
            top, bottom = (height * (i // columns + k) // rows for k in (0, 1))
            edge = 0 if len(snapshots) == 1 else 1
            self.draw(surface.subsurface((left, top, max(right - left - edge, 1), max(bottom - top - edge, 1))), seen)

    def array(self, snapshots: Sequence[Snapshot]) -> Bytes:
        """The same as an array of shape (480, 640, 3), uint8."""
        self.mosaic(self._surface, snapshots)
        return pixels(self._surface)


def pixels(surface: Any) -> Bytes:
    """What is on a surface, shape (height, width, 3), uint8."""
    width, height = surface.get_size()
    return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(height, width, 3).copy()
