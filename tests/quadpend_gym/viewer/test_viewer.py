"""What stands in a picture, where, how large, and in which colours."""

from itertools import combinations, product
from typing import Any

import numpy as np
import pygame
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import binary_erosion

from quadpend_gym import Reference
from quadpend_gym.viewer import hud, palette, scene
from quadpend_gym.viewer.camera import NEAR, Camera
from quadpend_gym.viewer.picture import Picture, surface_to_array
from quadpend_gym.viewer.snapshot import Snapshot
from quadpend_gym.viewer.text import TextRenderer
from quadpend_train.reports import side_by_side
from tests.helpers.viewer import (
    COLOUR_VISION,
    SIZE,
    Words,
    blown,
    drawn,
    extent,
    greenish,
    lab,
    like,
    middle,
    painted,
    projected,
    projected_metre,
    still,
)

BESIDE = Camera(azimuth=-np.pi / 2, elevation=0.0)  # x to the right, z upwards
ABOVE = Camera(azimuth=-np.pi / 2, elevation=np.pi / 2)  # x to the right, y upwards
CAMERAS = (Camera(), BESIDE, ABOVE, Camera(2.0, -0.1, 0.9), Camera(-3.0, 1.2, 15.0, 0.6))
BODY = (0.0, 0.0, 2.0)
BOB = (0.0, 0.0, 2.3)
GONE = still(position=(900.0, 0.0, 2.0))  # out of every picture


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_camera_is_a_rotated_pinhole(camera: Camera) -> None:
    at = np.array([1.0, -2.0, 3.0])
    points = at + np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3)) * camera.distance / 3
    assert_allclose(camera.view(at, *SIZE).project(points), projected(camera, at, points), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_segments_are_cut_where_they_pass_behind_the_camera(camera: Camera) -> None:
    at = np.array([0.5, 0.0, 1.0])
    ends = at + np.random.default_rng(1).normal(size=(200, 2, 3)) * camera.distance
    pixels, visible = camera.view(at, *SIZE).project_segments(ends.copy())
    depth = projected(camera, at, ends.reshape(-1, 3))[:, 2].reshape(-1, 2)
    assert (visible == (depth.max(axis=1) > NEAR)).all()
    assert (visible & (depth.min(axis=1) < NEAR)).sum() > 10
    for (a, b), (da, db), shown in zip(ends[visible], depth[visible], pixels[visible], strict=True):
        share = [(NEAR - here) / (there - here) if here < NEAR else 0.0 for here, there in ((da, db), (db, da))]
        cut = np.array([a + share[0] * (b - a), b + share[1] * (a - b)])
        assert_allclose(shown, projected(camera, at, cut), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("elevation", [-0.1, 0.0, 0.42, 1.4])
def test_the_horizon_is_where_level_ground_ends(elevation: float) -> None:
    camera = Camera(azimuth=0.3, elevation=elevation)
    at = np.array([0.0, 0.0, 2.0])
    far = at - 1e9 * np.array([[np.cos(0.3), np.sin(0.3), 0.0]])
    assert_allclose(camera.view(at, *SIZE).horizon(), projected(camera, at, far)[0, 1], atol=1e-4)


def test_from_the_top_all_is_ground_and_x_stays_to_the_right() -> None:
    view = ABOVE.view(np.array(BODY), *SIZE)
    assert view.horizon() == -np.inf
    right, away = view.project(np.array([[0.5, 0.0, 2.0], [0.0, 0.5, 2.0]]))[:, :2] - view.centre
    assert_allclose(right, (-away[1], 0.0), atol=1e-9)
    assert not like(drawn(still(), ABOVE), palette.SKY).any()


def test_orbit_and_zoom_keep_within_their_limits() -> None:
    camera = Camera()
    for sign in (1.0, -1.0):
        for _ in range(100):
            camera.orbit(0.1, sign * 0.1)
            camera.zoom(1.1**sign)
            assert -0.1 <= camera.elevation <= np.pi / 2
            assert 0.8 <= camera.distance <= 20.0
    assert_allclose(camera.azimuth, Camera().azimuth + 20.0)


def framed(seen: Snapshot, camera: Camera, points: Any, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the picture of a snapshot has these points in it, and not at its very edge."""
    views: list[Any] = []
    with monkeypatch.context() as patch:
        patch.setattr(scene, "draw", lambda surface, view, *rest: views.append(view))
        Picture(camera).draw(pygame.Surface(SIZE), seen)
    x, y, depth = views[0].project(np.array(points, float)).T
    return bool(((x > 10) & (x < SIZE[0] - 10) & (y > 10) & (y < SIZE[1] - 10) & (depth > NEAR)).all())


@pytest.mark.parametrize("zoom", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("elevation", [-0.1, 0.42, np.pi / 2])
def test_quadrotor_and_bob_are_in_the_picture_wherever_one_looks_from(
    elevation: float, zoom: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(0.4, elevation)
    camera.zoom(zoom)
    assert framed(still(), camera, [BODY, BOB], monkeypatch)


@pytest.mark.parametrize("height", [0.2, 1.0, 2.0, 2.5, 3.0])
def test_the_shadow_is_in_the_picture_at_every_height_of_the_task(
    height: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    reach = scene.ARM + scene.ROTOR
    shadow = [(reach, 0.0, 0.0), (-reach, 0.0, 0.0), (0.0, reach, 0.0), (0.0, -reach, 0.0)]
    points = [*shadow, (0.0, 0.0, height), (0.0, 0.0, height + 0.3 + scene.BOB)]
    assert framed(still(position=(0.0, 0.0, height)), Camera(), points, monkeypatch)


@pytest.mark.parametrize("camera", CAMERAS[:3])
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.8, 0.6)])
def test_the_bob_stands_where_it_is(direction: tuple[float, ...], camera: Camera) -> None:
    seen = still(direction=direction)._replace(reference=Reference.hover(z=1.0))
    place = projected(camera, BODY, [np.add(BODY, 0.3 * np.array(direction))])[0]
    found = like(painted(seen, camera, BODY), palette.BOB)
    assert_allclose(middle(found), place[:2], atol=4.0)  # its light side is brighter
    assert_allclose(extent(found), 2 * 0.9 * scene.BOB * projected_metre(camera, place), atol=4.0)


@pytest.mark.parametrize("camera", CAMERAS[:3])
def test_the_target_is_a_ring_where_the_bob_belongs(camera: Camera) -> None:
    seen = still()._replace(reference=Reference.hover(0.4, 0.5, 1.5))
    ring = like(painted(seen, camera, BODY), palette.REFERENCE, 40)
    place = projected(camera, BODY, [(0.4, 0.5, 1.8)])[0]
    assert_allclose(middle(ring), place[:2], atol=1.5)
    assert_allclose(extent(ring), 2 * 1.35 * scene.BOB * projected_metre(camera, place), atol=4.0)


@pytest.mark.parametrize("camera", CAMERAS[:3])
def test_the_reference_s_path_lies_where_the_bob_would_fly(camera: Camera) -> None:
    reference = Reference.figure_eight(0.8, 1.0, height=1.6)
    blue = like(painted(GONE._replace(reference=reference, time=2.0), camera, BODY), palette.REFERENCE, 60)
    path = reference.derivatives(np.linspace(-1.5, 5.5, 40))[:, 0, :3] + (0.0, 0.0, 0.3)
    for x, y, _ in projected(camera, BODY, path).round().astype(int):
        if 5 < x < SIZE[0] - 5 and 5 < y < SIZE[1] - 5:
            assert blue[y - 3 : y + 4, x - 3 : x + 4].any(), (x, y)


def test_the_trail_leads_to_the_bob_and_fades_with_age() -> None:
    trail = np.linspace((-0.8, 0.0, 2.3), BOB, 100)
    pixels = painted(still()._replace(trail=trail, reference=Reference.hover(z=0.5)), BESIDE, BODY)
    places = projected(BESIDE, BODY, trail[[20, 50, 80]]).round().astype(int)
    distances = [np.abs(pixels[y - 1 : y + 2, x].astype(int) - palette.BOB).sum(-1).min() for x, y, _ in places]
    assert distances[0] > distances[1] + 50 > distances[2] + 100
    assert not like(painted(still(), BESIDE, BODY), palette.BOB, 60)[:, :280].any()


def test_shadows_fall_straight_down() -> None:
    seen = still(position=(0.3, 0.4, 1.2))
    bare, pixels = (painted(here, Camera(), (0.3, 0.4, 0.6)).astype(int) for here in (GONE, seen))
    darker = (bare - pixels).min(axis=-1) > 30
    x, y, _ = projected(Camera(), (0.3, 0.4, 0.6), [(0.3, 0.4, 0.0)])[0].round().astype(int)
    assert darker[y - 3 : y + 4, x - 3 : x + 4].mean() > 0.8


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi])
def test_the_front_rotor_shows_the_heading(yaw: float) -> None:
    pixels = painted(still(euler=(0.0, 0.0, yaw)), ABOVE, BODY)
    warm = (pixels[..., 0].astype(int) - pixels[..., 2] > 40) & ~like(pixels, palette.BOB, 60)
    hub = scene.ARM * np.array([np.cos(yaw), np.sin(yaw)])
    assert_allclose(middle(warm), projected(ABOVE, BODY, [(*hub, 2.03)])[0, :2], atol=4.0)


def test_a_force_is_an_arrow_as_long_as_it_is_strong() -> None:
    (start, *_), metre = projected(BESIDE, BODY, [BODY])[0], projected_metre(BESIDE, (0, 0, BESIDE.distance))
    for force in (0.2, 0.4):
        green = like(painted(blown(force, 0.0, 0.0), BESIDE, BODY), palette.WIND)
        assert_allclose(np.argwhere(green)[:, 1].max() - start, force * scene.METRES_PER_NEWTON * metre, atol=2.0)


def test_the_wind_s_streaks_are_as_long_as_it_is_strong_and_calm_air_has_none() -> None:
    pale = [greenish(painted(blown(force, 0.0, 0.0), BESIDE, BODY)).sum() for force in (0.0, 0.2, 0.4)]
    assert pale[0] == 0
    assert_allclose(pale[2] / pale[1], 2.0, rtol=0.2)


def test_no_streak_of_a_storm_is_so_near_that_it_hides_the_scene() -> None:
    for drift in 0.37 * np.arange(12):
        pixels = painted(blown(1.0, 1.0, 0.1)._replace(streak_offset=np.full(3, drift)), Camera(), BODY)
        assert not binary_erosion(greenish(pixels), np.ones((11, 11))).any()


def gauged(seen: Snapshot, camera: Camera = BESIDE) -> Any:
    """The lower half of the gauges alone, on white."""
    surface = pygame.Surface(SIZE)
    surface.fill(palette.WHITE)
    hud.draw(surface, camera.view(np.array(BODY), *SIZE), TextRenderer(), seen, "", palette.BOB)
    return surface_to_array(surface)[SIZE[1] // 2 :]


def test_the_thrust_s_bar_is_half_full_in_hover() -> None:
    full = [like(gauged(still()._replace(thrust=float(u))), palette.SKY_BLUE).sum() for u in range(4)]
    assert full[0] < 0.03 * full[2]
    assert_allclose(full[1:], np.array([0.5, 1.0, 1.0]) * full[2], rtol=0.05)


def test_the_tilt_s_dot_goes_where_the_bob_leans_and_reaches_the_rim_at_the_limit() -> None:
    upright = middle(like(gauged(still()), palette.BOB))
    for (x, y), way in (((1, 0), (1, 0)), ((-1, 0), (-1, 0)), ((0, 1), (0, -1))):  # away is upwards
        for tilt in (np.pi / 6, np.pi / 3, 2.0):
            seen = still(direction=(x * np.sin(tilt), y * np.sin(tilt), np.cos(tilt)))
            moved = middle(like(gauged(seen), palette.BOB)) - upright
            assert_allclose(moved, 36.0 * min(tilt / (np.pi / 3), 1.0) * np.array(way), atol=1.5)


def test_the_wind_s_needle_points_where_it_blows() -> None:
    short, long = (extent(like(gauged(blown(force, 0.0, 0.0)), palette.WIND)) for force in (0.2, 0.4))
    assert long[0] > max(3 * long[1], 1.8 * short[0])
    width, height = extent(like(gauged(blown(0.0, 0.4, 0.0)), palette.WIND))
    assert height > 3 * width
    assert not like(gauged(still()), palette.WIND).any()


@pytest.mark.parametrize("size", [SIZE, (1280, 720), (320, 480), (320, 240), (160, 120), (400, 900)])
def test_time_and_return_are_written_legibly(size: tuple[int, int]) -> None:
    """Inside of the picture, not over each other, and in no letters too small to be read."""
    picture, words = Picture(), Words()
    picture.text = words
    picture.draw(pygame.Surface(size), still()._replace(time=1.23, episode_return=123.4, error=0.056), "flatness")
    if not words.written:
        assert size[1] < 320
        return
    assert {"1.23 s", "123.4", "56 mm", "time", "return", "flatness"} <= words.written.keys()
    sizes, boxes = zip(*words.written.values(), strict=True)
    assert all(pygame.Rect((0, 0), size).contains(box) for box in boxes)
    assert not [pair for pair in combinations(boxes, 2) if pair[0].colliderect(pair[1])]
    assert min(sizes) >= 12


SIGNS = ("REFERENCE", "WIND", "FRONT", "ROTOR", "BODY", "GROUND_NEAR")


def test_an_arrow_at_the_edge_points_to_a_target_out_of_view() -> None:
    for side in (1.0, -1.0):
        seen = still()._replace(reference=Reference.hover(20.0 * side, 0.0, 2.0))
        x, _ = middle(like(painted(seen, BESIDE, seen.focus), palette.REFERENCE))
        assert side * (x - SIZE[0] / 2) > 0.35 * SIZE[0]


TELLING = {
    **{name: getattr(palette, name) for name in SIGNS},
    **{f"policy {i}": colour for i, colour in enumerate(side_by_side.COLOURS)},
}


@pytest.mark.parametrize("vision", COLOUR_VISION)
def test_colours_that_mean_something_are_told_apart_by_the_colour_blind(vision: str) -> None:
    for one, other in combinations(TELLING, 2):
        difference = np.linalg.norm(lab(TELLING[one], vision) - lab(TELLING[other], vision))
        assert difference > 15.0, (one, other)


@pytest.mark.parametrize("vision", COLOUR_VISION)
def test_curves_are_told_from_the_true_wind_and_from_paper_by_the_colour_blind(vision: str) -> None:
    for colour, other in product(side_by_side.COLOURS, (side_by_side.TRUE, palette.WHITE)):
        assert np.linalg.norm(lab(colour, vision) - lab(other, vision)) > 15.0
