"""Doubts about vehicles: implausible numbers get a sentence, the presets none."""

from dataclasses import replace

import pytest

from quadpend_gym.vehicles import VEHICLES, Pole, Simulation, Vehicle, doubts

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
        (replace(HUMMINGBIRD, rotors=replace(ROTORS, torque_per_thrust=0.2)), "exceeds the arm of 0.17 m"),
        (replace(HUMMINGBIRD, pivot=(0.0, 0.0, 0.5)), "beyond the frame with arms of 0.17 m"),
        (replace(HUMMINGBIRD, rotors=replace(ROTORS, thrust=(0.2, 1.6))), "1.19 times the weight at most"),
        (replace(HUMMINGBIRD, rate_loop={"time_constant": 0.2}), "0.2 s pass until a command acts"),
        (replace(HUMMINGBIRD, pole=Pole(0.05, 1.13, 0.05 * 1.13**2 / 12.0)), "seems to be the full length of a tube"),
    ],
)
def test_each_doubt_is_said(vehicle: Vehicle, sentence: str) -> None:
    (found,) = doubts(Simulation(vehicle=vehicle, interface="body_rates"))
    assert sentence in found


def test_a_latency_beyond_the_fall_of_the_pole_is_doubted() -> None:
    (found,) = doubts(Simulation(vehicle=HUMMINGBIRD, interface="body_rates", latency=0.15))
    assert "0.15 s of the latency and 0.02 s of the rate loop" in found
