"""The picture shows rotors, pole and size of each vehicle."""

from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest
from numpy.testing import assert_allclose

from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.viewer import scene
from quadpend_gym.viewer.camera import NEAR
from quadpend_gym.viewer.picture import Picture
from quadpend_gym.viewer.snapshot import Snapshot, shape_of
from tests.helpers.viewer import SIZE, hovering

BODY = np.array([0.0, 0.0, 2.0])
RIGID = [name for name in VEHICLES if name != "paper"]


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


def test_an_environment_draws_its_vehicle() -> None:
    env = gym.make("quadpend_gym:QuadPendulum-v0", vehicle="crazyflie", render_mode="rgb_array")
    env.reset(seed=0)
    recorder = env.unwrapped.recorder  # type: ignore[attr-defined]
    assert_allclose(recorder.snapshot().shape.hubs, VEHICLES["crazyflie"].rotors.positions)  # type: ignore[union-attr]
    assert env.render().std() > 5.0  # type: ignore[union-attr]
