"""The picture shows rotors, pole and size of each vehicle."""

from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest
from numpy.testing import assert_allclose

from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.viewer import palette, scene
from quadpend_gym.viewer.camera import NEAR, Camera
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.shape import shape_of
from quadpend_gym.viewer.snapshot import Snapshot
from tests.helpers.viewer import SIZE, centroid, draw_scene, expected_projection, find_colour, hovering, in_wind

BODY = np.array([0.0, 0.0, 2.0])
RIGID = [name for name in VEHICLES if name != "paper"]
FROM_TOP = Camera(azimuth=-np.pi / 2, elevation=np.pi / 2)


def hovering_as(name: str, **fields: Any) -> Snapshot:
    """Return a snapshot of a vehicle at rest."""
    vehicle = VEHICLES[name]
    return hovering(**fields)._replace(shape=shape_of(vehicle), rod_length=vehicle.pole.length)


def view_of(snapshot: Snapshot, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the view with which a picture of a snapshot is drawn."""
    views: list[Any] = []
    monkeypatch.setattr(scene, "draw", lambda surface, view, *rest: views.append(view))
    Picture().draw(pygame.Surface(SIZE), snapshot)
    return views[0]


@pytest.mark.parametrize("name", RIGID)
def test_the_whole_vehicle_is_in_the_picture_and_large_enough_to_see(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shape, extent = shape_of(VEHICLES[name]), VEHICLES[name].pole.extent or 2.0 * VEHICLES[name].pole.length
    view = view_of(hovering_as(name), monkeypatch)
    x, y, depth = view.project(np.array([*(BODY + shape.hubs), BODY + shape.pivot + [0.0, 0.0, extent]])).T
    assert ((x > 10) & (x < SIZE[0] - 10) & (y > 10) & (y < SIZE[1] - 10) & (depth > NEAR)).all()
    assert np.ptp(x[:4]) > 16  # pixels
    assert y[:4].min() - y[4] > 150


@pytest.mark.parametrize("name", RIGID)
def test_the_front_rotors_are_at_their_places_and_the_ball_at_the_centre_of_the_pole(name: str) -> None:
    vehicle, shape = VEHICLES[name], shape_of(VEHICLES[name])
    camera = Camera(FROM_TOP.azimuth, FROM_TOP.elevation, 3.4 * shape.distance_scale)
    pixels = draw_scene(hovering_as(name, direction=(0.0, -1.0, 0.0)), camera, BODY)  # the pole hides no front rotor
    hubs = BODY + shape.hubs[list(shape.front)] + [0.0, 0.0, 0.03 * shape.scale]
    warm = (pixels[..., 0].astype(int) - pixels[..., 2] > 40) & ~find_colour(pixels, palette.BOB, 60)
    warm[expected_projection(camera, BODY, [BODY])[0, 1].astype(int) + 40 :] = False  # the rim of the ball is warm, too
    assert_allclose(centroid(warm), expected_projection(camera, BODY, hubs)[:, :2].mean(axis=0), atol=5.0)
    centre = BODY + vehicle.pivot + [0.0, -vehicle.pole.length, 0.0]
    ball = find_colour(pixels, palette.BOB)
    assert_allclose(centroid(ball), expected_projection(camera, BODY, [centre])[0, :2], atol=3.0)


def test_the_arrow_of_the_wind_is_as_long_as_that_of_the_same_fraction_of_another_weight() -> None:
    lengths = []
    for name in ("paper", "crazyflie"):
        shape, force = shape_of(VEHICLES[name]), 0.1 * VEHICLES[name].weight
        camera = Camera(-np.pi / 2, 0.0, 3.4 * shape.distance_scale)
        snapshot = in_wind(force, 0.0, 0.0)._replace(shape=shape)
        green = find_colour(draw_scene(snapshot, camera, BODY), palette.WIND)
        lengths.append(np.argwhere(green)[:, 1].max() - SIZE[0] / 2)
    assert_allclose(lengths[0], lengths[1], atol=4.0)


def test_an_environment_draws_its_vehicle() -> None:
    env = gym.make("quadpend_gym:QuadPendulum-v0", vehicle="crazyflie", render_mode="rgb_array")
    env.reset(seed=0)
    recorder = env.unwrapped.recorder  # type: ignore[attr-defined]
    assert_allclose(recorder.snapshot().shape.hubs, VEHICLES["crazyflie"].rotors.positions)  # type: ignore[union-attr]
    assert env.render().std() > 5.0  # type: ignore[union-attr]
