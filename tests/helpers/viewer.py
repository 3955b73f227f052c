"""Helpers of the viewer tests: snapshots and an independent projection."""

from typing import Any

import numpy as np
import pygame
from scipy.spatial.transform import Rotation

from quadpend_gym import Reference, State
from quadpend_gym.core.arrays import Booleans, Bytes, Floats
from quadpend_gym.viewer import scene
from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.picture import surface_to_array
from quadpend_gym.viewer.snapshot import Snapshot
from tests.helpers.envs import AT_REST

SIZE = (640, 480)


def assert_picture(picture: Any) -> None:
    """Check type, shape and layout of a picture, and that it has more than one colour."""
    assert isinstance(picture, np.ndarray)
    assert (picture.shape, picture.dtype) == ((480, 640, 3), np.uint8)
    assert picture.flags.c_contiguous
    assert picture.flags.owndata
    assert picture.std() > 5.0


def hovering(**fields: Any) -> Snapshot:
    """Return a snapshot at rest at the position of `Reference.hover()`, except for the given fields of the state."""
    state = State(np.concatenate([fields.get(name, value) for name, value in AT_REST.items()]).astype(float))
    return Snapshot(
        time=0.0,
        state=state,
        rod_length=0.3,
        reference=Reference.hover(),
        disturbance=np.zeros(9),
        error=0.0,
        tilt=float(state.alpha),
        episode_return=0.0,
        trail=(state.position + 0.3 * state.direction)[np.newaxis],
    )


def draw_scene(snapshot: Snapshot, camera: Camera, at: Floats | tuple[float, ...]) -> Bytes:
    """Return the picture of the scene without the head-up display; the camera looks at the point `at`."""
    surface = pygame.Surface(SIZE)
    scene.draw(surface, camera.view(np.asarray(at, float), *SIZE), snapshot)
    return surface_to_array(surface)


def expected_projection(camera: Camera, at: Any, points: Any) -> Floats:
    """Return pixels and depth of points, shape (n, 3), computed with a rotation of a camera on the x axis."""
    rotation = Rotation.from_euler("ZY", [camera.azimuth, -camera.elevation])
    x, y, z = rotation.inv().apply(np.asarray(points, float) - at).T
    depth = camera.distance - x
    focal = SIZE[1] / 2 / np.tan(camera.field_of_view / 2)
    return np.column_stack([SIZE[0] / 2 + focal * y / depth, SIZE[1] / 2 - focal * z / depth, depth])


def find_colour(pixels: Bytes, colour: tuple[int, int, int], tolerance: int = 12) -> Booleans:
    """Return where a picture has nearly this colour, shape (height, width)."""
    return np.asarray((np.abs(pixels.astype(int) - colour) <= tolerance).all(axis=-1))


def pixels_per_metre(camera: Camera, place: Any) -> float:
    """Return the pixels of 1 m across the view at the depth of a projected point."""
    return float(SIZE[1] / 2 / np.tan(camera.field_of_view / 2) / place[2])


def centroid(mask: Booleans) -> Floats:
    """Return the mean position of the true pixels, to the right and down, shape (2,)."""
    assert mask.any(), "the picture does not have this colour"
    return np.asarray(np.argwhere(mask).mean(axis=0)[::-1])


def extent(mask: Booleans) -> Floats:
    """Return width and height of the true pixels, shape (2,)."""
    return np.asarray(np.ptp(np.argwhere(mask), axis=0)[::-1])
