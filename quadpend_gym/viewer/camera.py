"""A perspective camera that orbits a point.

With azimuth a, elevation e and the distance d from the point P that it looks at, the camera stands at

    (1)  C = P + d (cos e cos a, cos e sin a, sin e)

and a point at depth w before it is drawn at F/w times its offset to the right and upwards, in pixels from the middle,
with F = height / (2 tan(angle/2)). All angles are in rad, lengths in m, the world's z points up.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats

NEAR = 0.1  # m, depth of the plane behind which nothing is drawn
_STEEPEST = np.pi / 2
_CLOSEST, _FARTHEST = 1.3, 20.0  # m


@dataclass
class Camera:
    """Where one looks from."""

    azimuth: float = -0.9
    elevation: float = 0.45
    distance: float = 3.4
    angle: float = 1.0  # of view, over the picture's height

    def orbit(self, azimuth: float, elevation: float) -> None:
        """Turn by these angles, from level up to the view from the top."""
        self.azimuth += azimuth
        self.elevation = float(np.clip(self.elevation + elevation, 0.0, _STEEPEST))

    def zoom(self, factor: float) -> None:
        """Change the distance."""
        self.distance = float(np.clip(self.distance * factor, _CLOSEST, _FARTHEST))

    def look(self, at: Floats, width: int, height: int) -> "View":
        """The view of a point, shape (3,), in a picture of this size."""
        ca, sa, ce, se = np.cos(self.azimuth), np.sin(self.azimuth), np.cos(self.elevation), np.sin(self.elevation)
        back = np.array([ce * ca, ce * sa, se])
        axes = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], -back])
        focal = 0.5 * height / np.tan(0.5 * self.angle)
        return View(at + self.distance * back, axes, focal, (0.5 * width, 0.5 * height))


class View(NamedTuple):
    """A camera in its place.

    Attributes:
        origin: C, shape (3,).
        axes: to the right, up and ahead, shape (3, 3).
        focal: F, pixels.
        middle: of the picture, pixels.
    """

    origin: Floats
    axes: Floats
    focal: float
    middle: tuple[float, float]

    def seen(self, points: Floats) -> Floats:
        """Points, shape (..., 3), as offsets to the right, up and ahead."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def project(self, points: Floats) -> Floats:
        """Pixels and depth, shape (..., 3), of points of that shape; of no meaning where the depth is below `NEAR`."""
        return self._flat(self.seen(points))

    def segments(self, ends: Floats) -> tuple[Floats, Floats]:
        """Line segments, shape (n, 2, 3), cut at the near plane.

        Returns:
            Pixels and depth of their ends, shape (n, 2, 3), and which are to be seen, shape (n,).
        """
        seen = self.seen(ends)
        depth = seen[..., 2]
        visible = depth.max(axis=1) > NEAR
        if (depth < NEAR).any():
            for one, other in ((0, 1), (1, 0)):
                cut = visible & (depth[:, one] < NEAR)
                a, b = seen[cut, one], seen[cut, other]
                share = (NEAR - a[:, 2]) / (b[:, 2] - a[:, 2])
                seen[cut, one] = a + share[:, np.newaxis] * (b - a)
            seen[~visible] = 1.0
        return self._flat(seen), visible

    def horizon(self) -> float:
        """Where level ground ends, pixels from the top; infinite where one looks straight down."""
        ahead, up = self.axes[2], self.axes[1]
        level = np.hypot(ahead[0], ahead[1])
        return self.middle[1] + self.focal * float(ahead[2]) / level if level > 1e-6 and up[2] > 0.0 else -np.inf

    def _flat(self, seen: Floats) -> Floats:
        flat = np.empty_like(seen)
        scale = self.focal / np.maximum(seen[..., 2], NEAR)
        flat[..., 0] = self.middle[0] + seen[..., 0] * scale
        flat[..., 1] = self.middle[1] - seen[..., 1] * scale
        flat[..., 2] = seen[..., 2]
        return flat
