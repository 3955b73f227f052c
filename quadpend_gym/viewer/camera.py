"""A perspective camera that orbits a target point.

With azimuth a, elevation e and distance d from the target P, the camera is at

    (1)  C = P + d (cos e cos a, cos e sin a, sin e)

A point at depth w in front of the camera is drawn at F/w times its offset to the right and upwards, in pixels from the
centre of the picture, where F = height / (2 tan(field_of_view/2)). All angles are in rad, lengths in m, the world's z
axis points up.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats

NEAR = 0.1  # m, depth of the near plane: nothing closer to the camera is drawn
_MAX_ELEVATION = np.pi / 2
_MIN_DISTANCE, _MAX_DISTANCE = 1.3, 20.0  # m


@dataclass
class Camera:
    """Position of the camera relative to its target, and its field of view."""

    azimuth: float = -0.9
    elevation: float = 0.45
    distance: float = 3.4
    field_of_view: float = 1.0  # over the height of the picture

    def orbit(self, azimuth: float, elevation: float) -> None:
        """Add to azimuth and elevation; the elevation stays between level and straight down."""
        self.azimuth += azimuth
        self.elevation = float(np.clip(self.elevation + elevation, 0.0, _MAX_ELEVATION))

    def zoom(self, factor: float) -> None:
        """Multiply the distance by `factor`, within limits."""
        self.distance = float(np.clip(self.distance * factor, _MIN_DISTANCE, _MAX_DISTANCE))

    def view(self, target: Floats, width: int, height: int) -> "View":
        """Return the view of a target point, shape (3,), in a picture of this size in pixels."""
        ca, sa, ce, se = np.cos(self.azimuth), np.sin(self.azimuth), np.cos(self.elevation), np.sin(self.elevation)
        backward = np.array([ce * ca, ce * sa, se])
        axes = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], -backward])
        focal_length = 0.5 * height / np.tan(0.5 * self.field_of_view)
        return View(target + self.distance * backward, axes, focal_length, (0.5 * width, 0.5 * height))


class View(NamedTuple):
    """The projection of a camera at a fixed position."""

    origin: Floats  # position C of the camera, m, shape (3,)
    axes: Floats  # unit vectors to the right, up and forward, shape (3, 3)
    focal_length: float  # F, pixels
    centre: tuple[float, float]  # centre of the picture, pixels from the left and from the top

    def to_camera(self, points: Floats) -> Floats:
        """Convert world points, shape (..., 3), to offsets to the right, up and forward, m."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def project(self, points: Floats) -> Floats:
        """Return pixels and depth of world points, shape (..., 3).

        The pixels are meaningless where the depth is below `NEAR`.
        """
        right, up, depth = np.moveaxis(self.to_camera(points), -1, 0)
        scale = self.focal_length / np.maximum(depth, NEAR)
        return np.stack([self.centre[0] + right * scale, self.centre[1] - up * scale, depth], axis=-1)

    def horizon(self) -> float:
        """Return the pixels from the top to the horizon; minus infinity if the camera looks straight down."""
        forward, up = self.axes[2], self.axes[1]
        level = np.hypot(forward[0], forward[1])
        if level > 1e-6 and up[2] > 0.0:
            return float(self.centre[1] + self.focal_length * forward[2] / level)
        return -np.inf
