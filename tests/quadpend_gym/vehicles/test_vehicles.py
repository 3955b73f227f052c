"""Vehicles as data: presets, plain data, and what follows from the rotors."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpend_gym.vehicles import (
    POLES,
    VEHICLES,
    RateLoop,
    Vehicle,
    as_vehicle,
    mixing,
    torque_limits,
)

WITH_ROTORS = [name for name, vehicle in VEHICLES.items() if vehicle.rotors]


def test_the_mixing_has_the_signs_of_the_picture() -> None:
    front_left = mixing(VEHICLES["racer"])[:, 0]
    assert_allclose(front_left, [1.0, 0.1, -0.075, 0.022])  # left lifts: roll to the right; front lifts: nose up
    front = mixing(VEHICLES["hummingbird"])[:, 0]
    assert_allclose(front, [1.0, 0.0, -0.17, 0.0169])


@pytest.mark.parametrize("name", WITH_ROTORS)
def test_the_torque_limits_are_the_largest_pure_torques_at_hover_thrust(name: str) -> None:
    vehicle = VEHICLES[name]
    assert vehicle.rotors
    roll_pitch, yaw = torque_limits(vehicle)

    def within(*torque: float) -> bool:
        thrusts = np.linalg.solve(mixing(vehicle), [vehicle.weight, *torque])
        return bool((thrusts >= vehicle.rotors.thrust[0]).all() and (thrusts <= vehicle.rotors.thrust[1]).all())

    inside, outside = 0.999, 1.001
    for sign in (-1, 1):
        assert within(inside * sign * roll_pitch, 0, 0)
        assert within(0, inside * sign * roll_pitch, 0)
        assert within(0, 0, inside * sign * yaw)
    assert not all(within(sign * outside * roll_pitch, 0, 0) for sign in (-1, 1)) or not all(
        within(0, sign * outside * roll_pitch, 0) for sign in (-1, 1)
    )
    assert not all(within(0, 0, sign * outside * yaw) for sign in (-1, 1))


def test_a_vehicle_may_have_a_full_inertia_and_be_given_as_plain_data() -> None:
    matrix = [[0.003, 1e-4, 0.0], [1e-4, 0.0032, 0.0], [0.0, 0.0, 0.0055]]
    vehicle = Vehicle(0.5, matrix, "hehn", torque=[0.4, 0.08])  # type: ignore[arg-type]
    assert_allclose(vehicle.inertia_matrix, matrix)
    assert vehicle.pole is POLES["hehn"]
    assert vehicle.rate_loop == RateLoop()
    assert vehicle.parameters.inertia_pitch == 0.0032


def test_a_toml_file_is_a_vehicle_with_the_name_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("mass = 1.0\ninertia = [0.01, 0.01, 0.018]\npole = 'tube-1m'\ntorque = [1.0, 0.2]\n")
    expected = Vehicle(1.0, (0.01, 0.01, 0.018), POLES["tube-1m"], "mine", torque=(1.0, 0.2))
    assert as_vehicle(str(path)) == as_vehicle(path) == expected
