"""Scenarios are data from a name, a file or JSON, and describe everything about an environment."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from quadpend_baselines import ADRC
from quadpend_gym import Parameters, Simulation
from quadpend_gym.scenarios import (
    HELD_OUT,
    SCENARIOS,
    SETS,
    Scenario,
    expand_sets,
    find_scenario,
    name_or_json,
    scenario_hash,
)
from quadpend_gym.wind import as_wind
from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import TrainSettings, read_settings

EVERYTHING = {
    "description": "everything at once",
    "wind": [{"kind": "dryden", "intensity": "light"}, "breeze"],
    "env_id": "QuadPendulumHover-v0",
    "sensors": {"kind": "noise", "position": 0.001},
    "actuators": [{"kind": "motor_lag"}, "rotors"],
    "parameters": {"share": 0.1, "names": ["bob_mass"]},
    "simulation": {"parameters": {"inertia_roll": 0.004, "inertia_pitch": 0.004}},
    "output_feedback": True,
    "history": 3,
    "history_actions": 2,
    "task": {"start": {"direction": 0.2}, "references": {"height": [1.0, 3.0]}},
    "duration": 3.0,
}
REAL = {"parameters": {"inertia_roll": 0.004, "inertia_pitch": 0.004, "inertia_yaw": 0.008}}


def test_all_fields_can_be_set_in_a_file_and_in_json(tmp_path: Path) -> None:
    (tmp_path / "mine.json").write_text(json.dumps(EVERYTHING), encoding="utf-8")
    scenario = find_scenario(str(tmp_path / "mine.json"))
    assert scenario == find_scenario(json.dumps(EVERYTHING)) == Scenario(**EVERYTHING)  # type: ignore[arg-type]
    env = scenario.make_vec(4, AutoresetMode.SAME_STEP)
    observation, info = env.reset(seed=0)
    assert observation.shape == (4, 3 * 27 + 2 * 4)
    assert {"air_velocity", "command", "parameters"} <= info.keys()
    env.step(np.zeros((4, 4), np.float32))


@pytest.mark.parametrize("scenario", [*SCENARIOS.values(), Scenario(**EVERYTHING)], ids=lambda item: item.description)  # type: ignore[arg-type]
def test_a_scenario_is_the_same_after_conversion_to_json_and_back(scenario: Scenario) -> None:
    assert find_scenario(json.dumps(asdict(scenario))) == scenario


def test_scenarios_with_the_name_of_a_wind_preset_have_that_wind() -> None:
    for name in ("calm", "breeze", "windy", "storm"):
        assert SCENARIOS[name].wind.models == as_wind(name)


def test_a_settings_file_can_contain_a_scenario(tmp_path: Path) -> None:
    text = 'num_envs = 16\n[scenario]\nwind = "storm"\noutput_feedback = true\n'
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    settings = read_settings(str(tmp_path / "mine.toml"))
    (scenario,) = settings.scenarios
    assert find_scenario(scenario) == Scenario(wind="storm", output_feedback=True)
    assert make_env(settings).observation_space.shape == (27,)


def test_settings_store_the_scenario_and_not_the_path_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('wind = "windy"\n', encoding="utf-8")
    (scenario,) = TrainSettings(scenarios=(str(path),)).scenarios
    path.unlink()
    assert find_scenario(scenario) == Scenario(wind="windy")
    assert name_or_json("windy") == "windy"


def test_a_controller_gets_rotor_allocation_and_the_nominal_simulation() -> None:
    rotors = Scenario(actuators="rotors", simulation=REAL)
    assert run_episodes([ADRC("paper")], rotors, 20).survived.mean() > 0.5
    # With the inertia of Table 1 the rotors' torque is too small.
    assert not run_episodes([ADRC("paper")], Scenario(actuators="rotors"), 5).survived.any()
    heavy = Simulation(Parameters(bob_mass=0.4))
    assert run_episodes([ADRC("paper")], Scenario(simulation=heavy), 20).survived.mean() > 0.9


def test_evaluate_takes_names_for_scenarios(tmp_path: Path) -> None:
    (tmp_path / "gale.toml").write_text('wind = "storm"\nduration = 1.0\n', encoding="utf-8")
    options = ["--episodes", "2", "--out", str(tmp_path), "--cache", str(tmp_path)]
    scenarios = ['light={"wind": "dryden", "duration": 1.0}', str(tmp_path / "gale.toml")]
    main(["evaluate", "adrc-paper", *options, "--scenarios", *scenarios])
    results = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"))
    assert list(results["scenarios"]) == ["light", "gale"]
    assert results["scenarios"]["light"]["wind"]["models"][0]["kind"] == "dryden"


def test_a_policy_that_does_not_fit_a_scenario_is_named_before_the_evaluation() -> None:
    with pytest.raises(
        ValueError, match="slow does not fit the scenario past: an observation has 36 or 27 numbers, not 144"
    ):
        compare({"slow": [ADRC("paper")]}, {"calm": "calm", "past": '{"history": 4}'}, 1)


@pytest.mark.parametrize(
    ("scenario", "sentence"),
    [
        ("hurricane", "there is no scenario 'hurricane'; the scenarios are calm"),
        ("training", "'training' is a set of scenarios: choose one of calm, breeze"),
        ('{"task": "loop"}', "there is no task 'loop'; the tasks are track, hover"),
        ("missing.toml", "there is no file 'missing.toml'"),
        ('{"wind": "windy"', "the scenario is not valid JSON"),
        ('{"winds": "windy"}', "scenario has no field 'winds'"),
        ('{"wind": "hurricane"}', "there is no wind 'hurricane'; there are calm"),
        ('{"env_id": "CartPole-v1"}', "env_id must be one of QuadPendulum-v0"),
        ('{"history": 0}', "history must be a whole number of at least 1, not 0"),
        ('{"history_actions": true}', "history_actions must be a whole number"),
        ('{"output_feedback": 1}', "output_feedback must be true or false"),
        ('{"description": 5}', "description must be a string"),
        ('{"sensors": "camera"}', "there is no sensor 'camera'; there are noise, delay, dropout"),
        ('{"sensors": {"kind": "sample_hold", "period": 0.015}}', "period of a SampleHold must be a whole multiple"),
        ('{"actuators": "rotor_fault"}', "a RotorFault needs rotors"),
        ('{"parameters": {"mass": [1, 2]}}', "parameters has no field 'mass'|ranges has no field 'mass'"),
        ("windy · crazyfly", "there is no vehicle 'crazyfly' \\(did you mean 'crazyflie'"),
        ("windy · paper · body_rates", "interface must be 'wrench', not 'body_rates'"),
        ("hummingbird_windy · paper", "interface must be 'wrench', not 'body_rates'"),
        ('{"actuators": "rotors"} · crazyflie · body_rates', 'Rotors needs the interface "wrench"'),
        ('{"simulation": {"period": 0}}', r"period must be a finite number in \[1e-09, 10\] s, not 0"),
        ('{"duration": 0}', "duration must be above zero"),
        ('{"duration": 0.015}', r"periods of 0.01 s \(simulation.period\), not 0.015 s"),
        ('{"duration": 1e300}', "whole number from 1 to 1000000 of control periods"),
        ('{"simulation": {"period": 0.003}}', r"periods of 0.003 s \(simulation.period\), not 10 s"),
    ],
)
def test_wrong_input_is_refused_with_one_sentence(scenario: str, sentence: str) -> None:
    with pytest.raises((ValueError, TypeError), match=sentence):
        find_scenario(scenario)


def test_an_invalid_file_is_named(tmp_path: Path) -> None:
    for name, text in (("a.toml", "wind = "), ("b.json", "[1]")):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=name):
            find_scenario(str(tmp_path / name))


def test_a_scenario_can_change_the_task() -> None:
    assert Scenario(task="track") == Scenario(task={})
    env = SCENARIOS["upset"].make_vec(400, AutoresetMode.SAME_STEP)
    assert env.reset(seed=0)[1]["tilt"].max() > 0.3
    assert SCENARIOS["calm"].make_vec(400, AutoresetMode.SAME_STEP).reset(seed=0)[1]["tilt"].max() < 0.2


@pytest.mark.parametrize(("of", "calm"), [("", "calm"), ("-hummingbird", "hummingbird_calm")])
def test_the_sets_have_only_the_calm_scenario_in_common(of: str, calm: str) -> None:
    training, test = SETS[f"training{of}"], SETS[f"test{of}"]
    assert set(training) & set(test) == {calm}
    for members in (training, test):
        assert len(set(members)) == len(members) >= 8
        assert set(members) <= SCENARIOS.keys()
    assert not SETS.keys() & SCENARIOS.keys()
    assert expand_sets(["windy", f"test{of}"]) == ["windy", *test]
    held_out = {scenario_hash(SCENARIOS[name]) for name in test} - {scenario_hash(SCENARIOS[calm])}
    assert not held_out & {scenario_hash(SCENARIOS[name]) for name in training}
    assert f"test{of}" in HELD_OUT


def test_as_flown_has_the_rates_and_the_latency_of_the_experiment() -> None:
    hover, *circles = (SCENARIOS[name].simulation for name in SETS["as-flown"])
    assert (hover.vehicle.name, hover.interface) == ("hummingbird", "body_rates")
    assert (hover.period, hover.latency, hover.vehicle.rate_loop.time_constant) == (0.02, 0.03, 0.02)
    assert all(simulation == hover for simulation in circles)
    for name, radius in zip(SETS["as-flown"][1:4], (0.1, 0.3, 0.5), strict=True):
        place = SCENARIOS[name].task.trajectory.derivatives(np.linspace(0.0, 4.0, 9))[:, 0, :2]
        np.testing.assert_allclose(np.linalg.norm(place, axis=1), radius)
    env = SCENARIOS["as_flown_circle_030"].make_vec(2, AutoresetMode.SAME_STEP)
    env.reset(seed=0)
    assert np.isfinite(env.step(np.zeros((2, 4), np.float32))[0]).all()


def test_a_scenario_with_another_vehicle_has_forces_of_its_weight() -> None:
    windy, light = SCENARIOS["windy"], find_scenario("windy · crazyflie · body_rates")
    assert light.simulation == Simulation(vehicle="crazyflie", interface="body_rates")
    (model,) = light.wind.models
    assert model.scale == pytest.approx(0.0298 * 9.81 / (0.7 * 9.8))
    assert model.wind == windy.wind
    assert "vehicle crazyflie, forces of the wind × 0.0426" in light.description
    assert windy.with_vehicle("paper").wind == windy.wind
    assert expand_sets(["training · crazyflie"]) == [f"{name} · crazyflie" for name in SETS["training"]]
    assert find_scenario('{"description": "a · b", "wind": "windy"} · crazyflie').wind == light.wind
    hummingbird = SCENARIOS["hummingbird_windy"]
    assert hummingbird.with_vehicle("crazyflie").simulation == light.simulation
    assert hummingbird.with_vehicle(interface="wrench").simulation.interface == "wrench"


def test_torques_of_the_wind_stay_as_strong_relative_to_the_torque_limits_of_the_vehicle() -> None:
    gusts, light = find_scenario("gusts"), find_scenario("gusts · crazyflie · body_rates")
    (model,), (scaled,) = gusts.wind.models, light.wind.models
    own, other = gusts.simulation.actuators, light.simulation.actuators
    yaw = other.yaw_torque / own.yaw_torque
    assert scaled.torque_scale == (*2 * [other.roll_pitch_torque / own.roll_pitch_torque], yaw)
    assert model.yaw_torque / own.yaw_torque == pytest.approx(yaw * model.yaw_torque / other.yaw_torque) == 0.05


def test_a_scenario_with_a_vehicle_file_becomes_json(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("mass = 1\ninertia = [0.01, 0.01, 0.02]\npole = 'tube-1m'\ntorque = [1, 0.2]\n", encoding="utf-8")
    assert name_or_json("windy · crazyflie") == "windy · crazyflie"
    assert TrainSettings(scenarios=("training · crazyflie",)).scenarios == ("training · crazyflie",)
    own = TrainSettings(scenarios=(f"windy · {path}",)).scenarios
    scenario = find_scenario(f"windy · {path}")
    path.unlink()
    assert find_scenario(own[0]) == scenario
    assert scenario.simulation.vehicle.name == "mine"


def test_the_hash_of_a_scenario_depends_on_everything_but_its_description() -> None:
    hashes = [scenario_hash(scenario) for scenario in SCENARIOS.values()]
    assert len(set(hashes)) == len(hashes)
    calm = scenario_hash(Scenario())
    assert calm == scenario_hash(Scenario(description="still air")) == scenario_hash(find_scenario("{}"))
    for change in (
        {"wind": "breeze"},
        {"task": "hover"},
        {"history": 2},
        {"simulation": {"substeps": 3}},
        {"duration": 3},
    ):
        assert scenario_hash(Scenario(**change)) != calm  # type: ignore[arg-type]


def test_the_hashes_of_the_published_results_stay_the_same() -> None:
    assert scenario_hash(SCENARIOS["calm"]) == scenario_hash(Scenario(duration=10)) == "5f0b3427c4f8"
    assert scenario_hash(SCENARIOS["windy"]) == "a39b74e9585a"
    assert scenario_hash(SCENARIOS["training_upset"]) == "1cf1ddb91f0d"
    assert scenario_hash(SCENARIOS["hover_windy"]) == "a6ba04431095"
    assert "duration" not in name_or_json('{"wind": "storm"}')
    assert find_scenario(name_or_json('{"duration": 3}')).duration == 3.0


def test_an_episode_lasts_the_duration_of_its_scenario_at_any_period() -> None:
    for period, steps in ((0.02, 5), (0.005, 20)):
        scenario = Scenario(simulation={"period": period}, duration=0.1)
        env = scenario.make_vec(1, AutoresetMode.SAME_STEP)
        env.reset(seed=0)
        ended = [bool(env.step(np.zeros((1, 4), np.float32))[3][0]) for _ in range(steps)]
        assert ended == [False] * (steps - 1) + [True]
        assert scenario.steps == steps


def test_the_steady_force_has_a_random_heading() -> None:
    env = SCENARIOS["steady"].make_vec(50, AutoresetMode.SAME_STEP)
    env.reset(seed=0)
    force = env.step(np.zeros((50, 4), np.float32))[4]["disturbance"][:, :3]
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 0.5)
    assert (np.ptp(force[:, :2], axis=0) > 0.9).all()
