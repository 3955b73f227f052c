"""Vehicles from presets and files reach the environment, its specification and its pictures."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from numpy.testing import assert_allclose

from quadpend_gym.physics.parameters import Simulation, as_simulation
from quadpend_gym.vehicles import VEHICLES
from quadpend_train.cli.main import main
from tests.helpers.bad_input import assert_refused
from tests.quadpend_gym.vehicles.test_bad_vehicles import GOOD, changed

ID = "quadpend_gym:QuadPendulum-v0"


@pytest.mark.parametrize("settings", [lambda path: {"vehicle": path}, lambda path: {"simulation": {"vehicle": path}}])
def test_the_specification_of_an_environment_has_the_vehicle_in_place_of_its_file(
    settings: Any, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    env: Any = gym.make(ID, **settings(str(path)))
    path.unlink()
    again: Any = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.world.simulation == env.unwrapped.world.simulation
    assert again.unwrapped.world.simulation.vehicle.name == "mine"


def test_another_vehicle_brings_its_own_numbers_along() -> None:
    hummingbird = Simulation(vehicle="hummingbird", interface="body_rates", latency=0.01)
    racer = as_simulation(hummingbird, "racer")
    assert racer == Simulation(vehicle="racer", interface="body_rates", latency=0.01)
    assert as_simulation(replace(hummingbird, interface="wrench", latency=0.0), "paper") == Simulation()


def test_parameters_that_are_not_those_of_the_vehicle_stay() -> None:
    heavy = replace(VEHICLES["hummingbird"].parameters, quadrotor_mass=0.6)
    assert as_simulation(Simulation(vehicle="hummingbird", parameters=heavy), "racer").parameters == heavy


@pytest.mark.parametrize("vehicle", ["racer", "paper"])
def test_replacing_a_vehicle_and_keeping_the_numbers_of_the_former_is_refused(vehicle: str) -> None:
    hummingbird = Simulation(vehicle="hummingbird")
    with pytest.raises(
        ValueError, match=f"must not be those of the vehicle 'hummingbird' if the vehicle is '{vehicle}'"
    ):
        replace(hummingbird, vehicle=vehicle)
    assert replace(hummingbird, vehicle=replace(hummingbird.vehicle, name="mine")).parameters == hummingbird.parameters


def test_the_picture_shows_the_thrust_that_the_rotors_have_reached() -> None:
    env: Any = gym.make(ID, vehicle="hummingbird", interface="rotors", render_mode="rgb_array")
    env.reset(seed=0)
    most = 4.0 * 3.8 / VEHICLES["hummingbird"].weight
    assert_allclose(env.unwrapped.recorder.snapshot().thrust, 1.0, atol=1e-9)
    env.step(np.ones(4, np.float32))
    share = 1.0 - np.exp(-0.01 / 0.015)  # the lag after a control period
    assert_allclose(env.unwrapped.recorder.snapshot().thrust, 1.0 + share * (most - 1.0), rtol=0.02)


@pytest.mark.parametrize("line", ["mass = 5000", "mas = 0.5", "mass = ", "mass = 0.5\nrotors = 4"])
def test_the_command_line_refuses_a_senseless_vehicle_with_one_sentence(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(changed("mass", line))
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", "lqr", "--scenarios", "calm", "--vehicle", "mine.toml"])
    printed = capsys.readouterr()
    assert caught.value.code == 2
    assert printed.err.startswith("quadpend: ")
    assert "mine.toml" in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""


@pytest.mark.parametrize(
    ("settings", "pattern"),
    [
        ({"vehicle": "humingbird"}, "did you mean 'hummingbird'"),
        ({"vehicle": "hummingbird", "interface": "rates"}, "did you mean 'body_rates'"),
        ({"interface": "rotors"}, "choose a rigid vehicle"),
        ({"vehicle": "missing.toml"}, "cannot be read"),
        ({"vehicle": {"mass": 1.0}}, "lacks the field"),
    ],
)
def test_an_environment_refuses_a_senseless_vehicle_with_one_sentence(settings: Any, pattern: str) -> None:
    assert_refused(lambda: gym.make(ID, **settings), pattern)


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_a_wrong_type_in_a_vehicle_is_refused_without_the_other_arguments_of_the_environment(
    make: Any, tmp_path: Path
) -> None:
    (tmp_path / "mine.toml").write_text(changed("mass", "mass = '0.6'"))
    with pytest.raises(ValueError, match=r"vehicle\.mass must be a number, not '0.6'$"):
        make(ID, vehicle=str(tmp_path / "mine.toml"), wind="windy")
