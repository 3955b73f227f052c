"""A picture of a snapshot."""

from dataclasses import replace
from typing import Any

import numpy as np
import pygame

from quadpend_gym.core.arrays import Bytes
from quadpend_gym.physics.state import Disturbance
from quadpend_gym.viewer import palette, scene
from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.palette import Colour, blend
from quadpend_gym.viewer.primitives import write
from quadpend_gym.viewer.snapshot import Snapshot

SIZE = (640, 480)
_SMALLEST_TEXT = 11  # pixels; smaller pictures have no text
_TARGET_BELOW = 0.24  # camera target below the vehicle, divided by the distance, so that the shadow is in the picture


class Picture:
    """Draws snapshots onto pygame surfaces with one camera, which may be changed between two pictures."""

    def __init__(self, camera: Camera | None = None) -> None:
        self.camera = camera or Camera()
        self._surface = pygame.Surface(SIZE)

    def draw(self, surface: Any, snapshot: Snapshot, title: str = "", colour: Colour = palette.BOB) -> None:
        """Draw a snapshot, with a title in the top left corner, over the whole of a surface.

        `colour` is that of the bob, its trail and the title.
        """
        shape = snapshot.shape
        camera = replace(self.camera, distance=self.camera.distance * shape.distance_scale)
        below = np.array([0.0, 0.0, _TARGET_BELOW * camera.distance * np.cos(camera.elevation) - shape.lift])
        view = camera.view(snapshot.state.position - below, *surface.get_size())
        scene.draw(surface, view, snapshot, colour)
        _write_numbers(surface, snapshot, title, colour)

    def render(self, snapshot: Snapshot) -> Bytes:
        """Draw a snapshot and return the picture, shape (480, 640, 3), uint8."""
        self.draw(self._surface, snapshot)
        return surface_to_array(self._surface)


def _write_numbers(surface: Any, snapshot: Snapshot, title: str, colour: Colour) -> None:
    """Write title, time, error, tilt, wind and return into the top left corner of a picture that is large enough."""
    size = round(min(surface.get_height() / 24.0, surface.get_width() / 22.0))  # pixels
    if size < _SMALLEST_TEXT:
        return
    rows = {
        "time": f"{snapshot.time:.2f} s",
        "error": f"{1e3 * snapshot.error:.0f} mm",
        "tilt": f"{np.degrees(snapshot.tilt):.0f}°",
        "wind": f"{np.linalg.norm(Disturbance(snapshot.disturbance).force):.2g} N",
        "return": f"{snapshot.episode_return:.1f}",
    }
    write(surface, title, (size, size), round(1.3 * size), blend(colour, palette.INK, 0.15))
    for i, (name, value) in enumerate(rows.items(), 1 + bool(title)):
        write(surface, name, (size, size * (i + 0.3)), size, palette.GREY)
        write(surface, value, (7 * size, size * (i + 0.3)), size, palette.INK, "topright")


def surface_to_array(surface: Any) -> Bytes:
    """Return the pixels of a pygame surface, shape (height, width, 3), uint8."""
    width, height = surface.get_size()
    return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(height, width, 3).copy()
