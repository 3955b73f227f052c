"""Random vehicles."""

import pytest

from experiments.one_policy import FIRST, SECOND, UNSEEN
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.vehicles import VEHICLES, as_vehicle
from quadpend_train.training.settings import read_settings


def test_a_seed_names_a_vehicle() -> None:
    vehicle = as_vehicle("random:17")
    assert vehicle == as_vehicle("random:17") != as_vehicle("random:18")
    assert vehicle.name == "random:17"
    assert find_scenarios("calm@random:17")["calm · random:17"].vehicle == vehicle


def test_random_vehicles_span_the_rigid_presets() -> None:
    drawn = [as_vehicle(f"random:{seed}") for seed in range(300)]
    for quantity in (
        lambda vehicle: vehicle.mass,
        lambda vehicle: vehicle.pole.equivalent_length,
        lambda vehicle: vehicle.rotors.lag_up,
        lambda vehicle: vehicle.rate_loop.time_constant,
    ):
        values = [quantity(vehicle) for vehicle in drawn]
        presets = [quantity(vehicle) for name, vehicle in VEHICLES.items() if name != "paper"]
        assert min(values) < min(presets) * 1.1
        assert max(values) > max(presets) * 0.9


def test_what_is_no_seed_is_refused() -> None:
    with pytest.raises(ValueError, match="or random:SEED"):
        as_vehicle("random:x")


def test_the_one_policy_did_not_train_on_the_vehicles_of_its_test() -> None:
    presets = [read_settings(name).scenarios for name in (FIRST, SECOND, "apg-vehicles-safe")]
    trained = {scenario.vehicle.name for scenarios in presets for scenario in scenarios}
    assert not trained & set(UNSEEN)
