"""Positions, sizes and colours of what a picture shows."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym import Reference
from quadpend_gym.viewer import palette
from quadpend_gym.viewer.camera import Camera
from quadpend_gym.viewer.snapshot import ARM, PAPER_SHAPE
from tests.helpers.viewer import (
    SIZE,
    centroid,
    draw_scene,
    expected_projection,
    extent,
    find_colour,
    hovering,
    pixels_per_metre,
)

FROM_SIDE = Camera(azimuth=-np.pi / 2, elevation=0.0)  # x to the right, z upwards
FROM_TOP = Camera(azimuth=-np.pi / 2, elevation=np.pi / 2)  # x to the right, y upwards
CAMERAS = (Camera(), FROM_SIDE, FROM_TOP)
BODY = (0.0, 0.0, 2.0)
OUT_OF_VIEW = hovering(position=(900.0, 0.0, 2.0))  # far outside of every picture


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.8, 0.6)])
def test_the_bob_is_drawn_at_its_position(direction: tuple[float, ...], camera: Camera) -> None:
    snapshot = hovering(direction=direction)._replace(reference=Reference.hover(z=1.0))
    place = expected_projection(camera, BODY, [np.add(BODY, 0.3 * np.array(direction))])[0]
    found = find_colour(draw_scene(snapshot, camera, BODY), palette.BOB)
    assert_allclose(centroid(found), place[:2], atol=4.0)  # the highlight has another colour
    assert_allclose(extent(found), 2 * 0.9 * PAPER_SHAPE.bob * pixels_per_metre(camera, place), atol=4.0)


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_reference_path_is_that_of_the_bob(camera: Camera) -> None:
    reference = Reference.figure_eight(0.8, 1.0, height=1.6)
    blue = find_colour(
        draw_scene(OUT_OF_VIEW._replace(reference=reference, time=2.0), camera, BODY), palette.REFERENCE, 60
    )
    path = reference.derivatives(np.linspace(-1.5, 5.5, 40))[:, 0, :3] + (0.0, 0.0, 0.3)
    for x, y, _ in expected_projection(camera, BODY, path).round().astype(int):
        if 5 < x < SIZE[0] - 5 and 5 < y < SIZE[1] - 5:
            assert blue[y - 3 : y + 4, x - 3 : x + 4].any(), (x, y)


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi])
def test_the_front_rotor_shows_the_heading(yaw: float) -> None:
    pixels = draw_scene(hovering(euler=(0.0, 0.0, yaw)), FROM_TOP, BODY)
    warm = (pixels[..., 0].astype(int) - pixels[..., 2] > 40) & ~find_colour(pixels, palette.BOB, 60)
    hub = ARM * np.array([np.cos(yaw), np.sin(yaw)])
    assert_allclose(centroid(warm), expected_projection(FROM_TOP, BODY, [(*hub, 2.03)])[0, :2], atol=4.0)
