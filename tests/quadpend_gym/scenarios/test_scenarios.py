"""A scenario is data: from a name, a file, JSON or own code, and it describes everything about an environment."""

import json
import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import TypeAdapter

from quadpend_gym import Drawn, OrnsteinUhlenbeck, Reference, Rescaled, Waypoints
from quadpend_gym.scenarios import (
    SCENARIOS,
    SETS,
    Scenario,
    as_scenario,
    find_scenario,
    find_scenarios,
    own_models,
    refuse_held_out,
    scenario_data,
)
from quadpend_gym.tasks.task import TASKS, Task
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import as_wind
from tests.helpers.envs import draw_actions
from tests.helpers.own_code import write_module
from tests.helpers.sources import ROOT

EVERYTHING: dict[str, Any] = {
    "name": "all",
    "description": "everything at once",
    "wind": [{"kind": "dryden", "intensity": "light"}, "breeze"],
    "sensors": {"kind": "noise", "position": 0.001},
    "actuators": [{"kind": "motor_lag"}, {"kind": "packet_loss"}],
    "parameters": {"share": 0.1, "names": ["bob_mass"]},
    "loop": {"latency": [0.01, 0.03], "jitter": 0.002, "rate_loop": [0.8, 1.2]},
    "autopilot": None,  # needs the firmware otherwise
    "vehicle": "hummingbird",
    "interface": "body_rates",
    "latency": 0.02,
    "period": 0.02,
    "substeps": 8,
    "observation": ["attitude", "tracking_error"],
    "pole_told": True,
    "loop_known": False,
    "task": {"start": {"direction": 0.2}, "references": {"height": [1.0, 3.0]}, "jumps": {"distance": [0.1, 0.2]}},
    "duration": 0.1,
    "wind_rise": 0.05,
    "unscored": 0.04,
}


def test_every_field_can_be_set_in_a_file_in_json_and_in_gym_make(tmp_path: Path) -> None:
    (tmp_path / "mine.json").write_text(json.dumps(EVERYTHING), encoding="utf-8")
    scenario = find_scenario(str(tmp_path / "mine.json"))
    assert scenario == find_scenario(json.dumps(EVERYTHING)) == Scenario(**EVERYTHING)
    assert EVERYTHING.keys() == {item.name for item in fields(Scenario)}
    env = scenario.make_vec(4)
    observation, info = env.reset(seed=0)
    assert observation.shape == (4, 6)
    assert {"air_velocity", "command", "parameters", "loop"} <= info.keys()
    kept = {name: EVERYTHING[name] for name in EVERYTHING.keys() - {"name", "description", "loop_known"}}
    single = gym.make("quadpend_gym:QuadPendulum-v0", **kept)
    assert_array_equal(single.reset(seed=2)[0], observation[2])


@pytest.mark.parametrize("scenario", [*SCENARIOS.values(), Scenario(**EVERYTHING)], ids=lambda item: item.name)
def test_a_scenario_is_the_same_after_conversion_to_data_and_back(scenario: Scenario) -> None:
    again = find_scenario(json.dumps(scenario_data(scenario)))
    assert again == scenario
    assert (again.name, again.description) == (scenario.name, scenario.description)


def test_the_schema_is_valid_complete_and_accepts_the_scenarios() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = TypeAdapter(Scenario).json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    assert EVERYTHING.keys() == set(schema["properties"])
    validator = jsonschema.Draft202012Validator(schema)
    for data in (EVERYTHING, *(json.loads(json.dumps(scenario_data(item))) for item in SCENARIOS.values())):
        validator.validate(data)
    assert not validator.is_valid({"latency": 2.0})
    assert not validator.is_valid({"wnd": "windy"})


def test_a_scenario_may_change_another_one(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("base = 'event_jump'\ntask = {jumps = {distance = [0.3, 0.4]}}\nlatency = 0.03\n", encoding="utf-8")
    (found,) = find_scenarios(str(file)).values()
    own = {"task": {"jumps": {"distance": [0.3, 0.4]}}, "latency": 0.03}
    assert found == as_scenario("event_jump", **own, name="mine", description="") != SCENARIOS["event_jump"]
    assert as_scenario({"base": "event_jump", **own}) == replace(found, name="")
    file.write_text("[scenarios]\na = {base = 'event_jmp'}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"mine.toml: there is no scenario 'event_jmp' \(did you mean 'event_jump'"):
        find_scenarios(str(file))
    file.write_text(f"base = '{file.as_posix()}'\n", encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"base must be a scenario of this package or of another file, not of '.*mine.toml'"
    ):
        find_scenarios(str(file))


@pytest.mark.parametrize("name", ["own_task", "value"])
def test_what_is_beside_a_base_is_a_field(name: str) -> None:
    with pytest.raises(ValueError, match=f"Scenario has no field '{name}'"):
        as_scenario({"base": "windy", name: "recovery"})
    with pytest.raises(ValueError, match="base must be"):
        as_scenario({"base": None, "period": 0.01})


def test_a_file_holds_one_scenario_or_many_with_sets_and_defaults(tmp_path: Path) -> None:
    one, many = tmp_path / "one.toml", tmp_path / "many.toml"
    one.write_text('wind = "windy"\n', encoding="utf-8")
    many.write_text(
        "defaults = {duration = 3.0}\nsets = {both = ['a', 'b']}\n[scenarios]\na = {}\nb = {wind = 'storm'}\n",
        encoding="utf-8",
    )
    found = find_scenarios([str(one), str(many), f"gale={one}", "windy"])
    assert list(found) == ["one", "a", "b", "gale", "windy"]
    assert found["one"] == found["gale"] == found["windy"]
    assert found["b"] == Scenario(wind="storm", duration=3.0)
    with pytest.raises(ValueError, match="is a set of scenarios: choose one of a, b"):
        find_scenario(str(many))
    with pytest.raises(ValueError, match="two scenarios have the name 'calm'"):
        find_scenarios(["calm", "calm=windy"])


@pytest.mark.parametrize(("of", "calm"), [("", "calm"), ("-hummingbird", "hummingbird_calm")])
def test_training_and_held_out_sets_have_only_the_calm_scenario_in_common(of: str, calm: str) -> None:
    training, test = (list(find_scenarios(f"{name}{of}").values()) for name in ("training", "test"))
    assert [scenario for scenario in training if scenario in test] == [SCENARIOS[calm]]
    assert not SETS.keys() & SCENARIOS.keys()
    refuse_held_out([f"training{of}"])
    with pytest.raises(ValueError, match="held out"):
        refuse_held_out([f"test{of}@racer"])


def test_the_flight_benchmark_has_four_parts_and_no_test_scenario_in_its_training_set() -> None:
    for whole, names in (("flight", "wind loop vehicle motion"), ("events", "signals forces vehicle motion")):
        parts = [SETS[f"{whole}-{name}"] for name in names.split()]
        assert SETS[whole] == tuple(name for part in parts for name in part)
    held_out = [*find_scenarios(["flight", "recovery-flight"]).values()]
    assert not [scenario for scenario in find_scenarios("training-flight").values() if scenario in held_out]
    assert all((item.wind_rise, item.unscored, item.duration) == (1.0, 2.0, 12.0) for item in held_out[:-7])
    refuse_held_out(["training-flight"])
    for name in ("flight", "flight-wind", "events", "events-signals", "recovery-flight"):
        with pytest.raises(ValueError, match="held out"):
            refuse_held_out([name])


@pytest.mark.parametrize(
    "held_out",
    [
        "storm",
        "gale=storm",
        "storm@racer",
        "flight_dryden_fast@crazyflie",
        '{"wind": "storm", "duration": 5.0}',
        '{"wind": "storm", "wind_rise": 0.001}',
        "FILE",
    ],
)
def test_a_held_out_scenario_is_refused_under_any_name_and_on_any_vehicle(held_out: str, tmp_path: Path) -> None:
    (file := tmp_path / "mine.toml").write_text('[scenarios]\nb = {wind = "storm", vehicle = "racer"}\n', "utf-8")
    with pytest.raises(ValueError, match=r"scenarios cannot be .*, which is held out"):
        refuse_held_out(["windy", held_out.replace("FILE", str(file))])


def test_the_scenarios_of_every_training_set_may_be_trained_in() -> None:
    refuse_held_out([name for name in SETS if name.startswith("training")])
    refuse_held_out(
        ["calm", "swing_up", "load_windy@racer", '{"wind": "storm", "sensors": {"kind": "noise", "position": 1}}']
    )


def test_the_wind_of_a_scenario_rises() -> None:
    """Forces, torques and velocities are those of the sudden wind times min(t/wind_rise, 1), bit for bit after it."""
    wind = [{"kind": "drawn", "wind": {"kind": "dryden"}}, {"kind": "ornstein_uhlenbeck", "force": 1.0, "torque": 0.1}]
    sudden, rising = (gym.make("quadpend_gym:QuadPendulum-v0", wind=wind, wind_rise=rise) for rise in (0.0, 0.2))
    action = np.zeros(4, np.float32)
    for env in (sudden, rising):
        env.reset(seed=3)
    for step in range(30):
        full, found = (env.unwrapped.world.wind for env in (sudden, rising))  # type: ignore[attr-defined]
        assert_allclose(found, min((step + 0.5) * 0.01 / 0.2, 1.0) * full, rtol=1e-12)
        assert step < 20 or (found == full).all()
        sudden.step(action), rising.step(action)


def test_presets_of_wind_are_relative_to_the_weight_and_exactly_themselves_for_the_papers_vehicle() -> None:
    for name in ("breeze", "windy", "storm"):
        assert SCENARIOS[name].wind_models == as_wind(name)[0].parts
    (light,) = Scenario(wind="windy", vehicle="crazyflie").wind_models
    assert isinstance(light, Rescaled)
    assert light.scale == pytest.approx(0.0298 * 9.81 / (0.7 * 9.8))
    plain = {"kind": "ornstein_uhlenbeck", "force": 0.3}
    assert light.wind.models == as_wind(plain)
    for wind in (plain, OrnsteinUhlenbeck(0.3)):
        assert Scenario(wind=wind, vehicle="crazyflie").wind_models == as_wind(plain)
    for wind in ({"kind": "relative", "wind": plain}, ["windy"], as_wind("windy")):
        assert Scenario(wind=wind, vehicle="crazyflie").wind_models == (light,)
    for flown in (
        Scenario(wind=Drawn("windy"), vehicle="crazyflie"),
        Scenario(wind=Drawn("windy")).with_vehicle("crazyflie"),
    ):
        assert flown.wind_models[0] in (Drawn(light), Rescaled(Drawn(plain), light.scale, light.torque_scale))


def test_another_vehicle_has_wind_of_its_weight_and_its_torque_limits() -> None:
    gusts = Scenario(name="gusts", wind={"kind": "paper_gusts", "yaw_torque": 0.1})
    light = gusts.with_vehicle("crazyflie", "body_rates")
    (model,) = light.wind_models
    before, after = gusts.simulation, light.simulation
    assert light.name == "gusts · crazyflie · body_rates"
    assert model.scale == after.parameters.hover_thrust / before.parameters.hover_thrust
    ratios = np.divide(after.torque_limits, before.torque_limits)
    assert_allclose(model.torque_factors, [ratios[0], ratios[0], ratios[1]])
    assert gusts.with_vehicle("paper").wind == gusts.wind
    assert (
        SCENARIOS["windy"].with_vehicle("crazyflie").wind_models
        == Scenario(wind="windy", vehicle="crazyflie").wind_models
    )


@pytest.mark.parametrize("name", ["square", "lissajous", "ellipse"])
def test_the_examples_of_the_documentation_are_feasible(name: str, recwarn: pytest.WarningsRecorder) -> None:
    scenario = find_scenario(str(ROOT / f"docs/scenarios/{name}.toml"))
    assert isinstance(scenario.task.trajectory, Waypoints if name == "square" else Reference)
    assert not recwarn
    drop = {"kind": "waypoints", "times": [0, 0.5], "points": [[0, 0, 4], [0, 0, 1]]}
    with pytest.raises(ValueError, match="the trajectory cannot be flown"):
        replace(scenario, task={"trajectory": drop})


CODE = '''
import numpy as np
from quadpend_gym import OrnsteinUhlenbeck
from quadpend_gym.scenarios import Scenario


class Push:
    """A force along x that any object with these four names can be."""

    moves_air, memory_size = False, 0

    def initial_memory(self, streams):
        return np.zeros((streams.keys.size, 0))

    def sample(self, out, memory, step, period, streams):
        out[:, 0] += 0.5


def noisy():
    return Scenario(wind=[OrnsteinUhlenbeck(0.3), Push()], sensors={"kind": "noise", "position": 0.001})
'''


def test_own_code_gives_a_wind_or_a_whole_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_module(tmp_path, monkeypatch, CODE)
    (tmp_path / "push.toml").write_text(f'wind = "{module}:Push"', encoding="utf-8")
    push, noisy = find_scenario(f"{module}:Push"), find_scenario(f"{module}:noisy")
    assert push == find_scenario("push.toml") == find_scenario(json.dumps(scenario_data(push)))
    assert len(noisy.wind_models) == 2
    assert "Push object" in json.dumps(scenario_data(noisy))
    assert own_models(push)
    assert own_models(noisy)
    assert not own_models(SCENARIOS["storm"])


OWN_MODELS = """
import numpy as np

from quadpend_gym.sensors import Dropout


class Sticky:
    memory_size = 4

    def initial_memory(self, streams):
        return np.zeros((streams.keys.size, 4))

    def sense(self, measured, memory, step, period, streams):
        measured[:, :3] += memory[:, :3]
        memory[:, :3] += 0.25

    def act(self, action, memory, step, simulation, streams):
        action[:], memory[:] = memory.copy(), action.copy()


def two():
    return [Sticky(), Sticky()]
"""


def test_own_code_gives_sensors_and_actuators(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They act as the same models in a list, each with its own memory, and can be written as JSON."""
    module = write_module(tmp_path, monkeypatch, OWN_MODELS)
    noise, observation = {"kind": "noise", "position": 0.001}, ["position"]
    own = Scenario(sensors=[noise, f"{module}:two"], actuators=f"{module}:Sticky", observation=observation)
    assert find_scenario(json.dumps(scenario_data(own))) == pickle.loads(pickle.dumps(own)) == own
    assert own_models(own)
    seen = []
    for scenario in (own, Scenario(sensors=noise, actuators="action_delay", observation=observation)):
        env = scenario.make_vec(3)
        seen.append([env.reset(seed=0)[0], *(env.step(action)[0] for action in 0.1 * draw_actions(0, 9, 3))])
    shift = np.subtract(*seen)
    assert_allclose(shift, np.broadcast_to(0.5 * np.arange(10)[:, np.newaxis, np.newaxis], shift.shape), atol=1e-6)
    with pytest.raises(ValueError, match=f"{module}:Dropout must return models of your own classes, not Dropout: list"):
        Scenario(sensors=f"{module}:Dropout")


def test_a_factory_that_returns_nothing_and_a_module_that_ends_the_program_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forgetful = write_module(tmp_path, monkeypatch, "def wind():\n    pass\n")
    with pytest.raises(ValueError, match=f"{forgetful}:wind must return wind models: it returns None"):
        as_wind(f"{forgetful}:wind")
    ending = write_module(tmp_path, monkeypatch, "import sys\nsys.exit(3)\n")
    with pytest.raises(ValueError, match=f"the module '{ending}' cannot be imported.* SystemExit: 3"):
        as_wind(f"{ending}:wind")


def test_a_mapping_changes_the_scenarios_own_part_and_an_object_replaces_it(recwarn: pytest.WarningsRecorder) -> None:
    found, effort = SCENARIOS["flight_training_wind"], {"reward": {"effort": 0.3}}
    task = replace(found.task, reward=replace(found.task.reward, effort=0.3))
    own = {"task": {"start": {"direction": 0.2}}, "loop": {"latency": [0.01, 0.03], "jitter": 0.002}}
    assert (
        as_scenario("flight_training_wind", task=effort) == as_scenario(found, task=task) == replace(found, task=task)
    )
    merged = as_scenario(own, task=effort, loop={"jitter": 0.0})
    assert merged == Scenario(task={**own["task"], **effort}, loop={"latency": [0.01, 0.03]})  # type: ignore[arg-type]
    assert as_scenario({"task": "hover"}, task=effort).task.references == TASKS["hover"].references
    assert as_scenario("uncertain", parameters={"share": 0.5}).parameters == replace(
        SCENARIOS["uncertain"].parameters, share=0.5
    )
    assert as_scenario("hummingbird_windy", vehicle={"mass": 0.8}).vehicle == replace(VEHICLES["hummingbird"], mass=0.8)
    assert not recwarn
    with pytest.warns(
        UserWarning, match="replaces references and start of the scenario by those of 'track'.*a mapping"
    ):
        assert as_scenario(found, task=Task(reward={"effort": 0.3})).task == Task(reward={"effort": 0.3})  # type: ignore[arg-type]


def test_substeps_keep_their_length_when_only_the_period_changes() -> None:
    found = [as_scenario(*item).simulation.substeps for item in ((None,), ("flight_breeze",))]
    assert found == [2, 4]
    cases = ((None, 8), ("flight_breeze", 16), ({"substeps": 4}, 16), ({"period": 0.02, "substeps": 4}, 8))
    for given, substeps in cases:
        assert as_scenario(given, period=0.04).simulation.substeps == substeps
        assert as_scenario(given, period=0.04, substeps=10).simulation.substeps == 10
    assert Scenario(period=0.013).simulation.substeps == 3


def test_a_latency_is_refused_where_every_episode_draws_its_own() -> None:
    with pytest.raises(ValueError, match="latency: the scenario draws it for each episode"):
        as_scenario("flight_late", latency=0.01)
