"""Doubts about vehicles: implausible numbers get a sentence, the presets none."""

from dataclasses import replace

import numpy as np
import pytest

from quadpend_gym.vehicles import VEHICLES, Pole, Simulation, Vehicle, doubts, rotors_of

HUMMINGBIRD = VEHICLES["hummingbird"]
ROTORS = HUMMINGBIRD.rotors
assert ROTORS is not None


@pytest.mark.parametrize("name", VEHICLES)
def test_presets_are_plausible(name: str) -> None:
    rigid = VEHICLES[name].attitude == "rigid"
    assert doubts(Simulation(vehicle=VEHICLES[name], interface="body_rates" if rigid else "wrench")) == []


@pytest.mark.parametrize(
    ("vehicle", "sentence"),
    [
        (
            replace(HUMMINGBIRD, rotors=replace(ROTORS, torque_per_thrust=0.2)),
            "rotors.torque_per_thrust over arm is 1.18, of most quadrotors 0.02 to 0.45",
        ),
        (replace(HUMMINGBIRD, pivot=(0.0, 0.0, 0.5)), "pivot over arm is 2.94"),
        (
            replace(HUMMINGBIRD, rotors=replace(ROTORS, thrust=(0.2, 1.6))),
            "rotors.thrust of all four over the weight is 1.19",
        ),
        (replace(HUMMINGBIRD, rate_loop={"time_constant": 0.2}), "0.2 s pass until a command acts"),
        (replace(HUMMINGBIRD, pole=Pole(0.05, 1.13, 0.05 * 1.13**2 / 12.0)), "seems to be the full length of a tube"),
    ],
)
def test_each_doubt_is_said(vehicle: Vehicle, sentence: str) -> None:
    (found,) = doubts(Simulation(vehicle=vehicle, interface="body_rates"))
    assert sentence in found


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("name", ["hummingbird", "skydio-x2", "racer", "x500"])
def test_a_factor_of_ten_is_doubted_or_refused(name: str, factor: float) -> None:
    vehicle = VEHICLES[name]
    given = {
        "": {"mass": vehicle.mass, "inertia": vehicle.inertia, "gravity": vehicle.gravity},
        "pole": {each: getattr(vehicle.pole, each) for each in ("mass", "length", "inertia")},
        "rotors": {each: getattr(rotors_of(vehicle), each) for each in ("positions", "torque_per_thrust", "lag_up")},
        "rate_loop": {each: getattr(vehicle.rate_loop, each) for each in ("time_constant", "roll_pitch", "yaw")},
    }
    for part, numbers in given.items():
        for field, number in numbers.items():
            wrong = {field: (factor * np.array(number)).tolist()}
            try:
                other = replace(vehicle, **({part: replace(getattr(vehicle, part), **wrong)} if part else wrong))
            except ValueError:
                continue
            assert doubts(Simulation(vehicle=other, interface="body_rates")), f"{part} {field}"


def test_a_latency_beyond_the_fall_of_the_pole_is_doubted() -> None:
    (found,) = doubts(Simulation(vehicle=HUMMINGBIRD, interface="body_rates", latency=0.15))
    assert "0.15 s of the latency and 0.02 s of the rate loop" in found
