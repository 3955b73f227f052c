"""Scenarios with wind of the user's own code: by module:factory and as objects."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import ADRC, controller
from quadpend_gym import OrnsteinUhlenbeck, RewardWeights
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import SCENARIOS, Scenario, as_scenario, find_scenario, own_models, scenario_hash
from quadpend_train import evaluate
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.jobs import Job, load_learner
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import TrainSettings, from_mapping, read_settings, to_mapping
from tests.helpers.own_code import write_module

CODE = '''
import numpy as np
from quadpend_gym import OrnsteinUhlenbeck
from quadpend_train import Scenario


class Push:
    """A force along x that any object with these four names can be."""

    moves_air, memory_size = False, 0

    def __init__(self, force=0.5):
        self.force = force

    def initial_memory(self, streams):
        return np.zeros((streams.keys.size, 0))

    def sample(self, out, memory, step, period, streams):
        out[:, 0] += self.force


def noisy():
    return Scenario(wind=[OrnsteinUhlenbeck(0.3), Push()], sensors={"kind": "noise", "position": 0.001})


def number():
    return 3


class Failing(Push):
    def sample(self, out, memory, step, period, streams):
        raise KeyError("x")
'''


class Push:
    moves_air, memory_size = False, 0

    def __init__(self, force: float) -> None:
        self.force = force

    def initial_memory(self, streams: Any) -> Floats:
        return np.zeros((streams.keys.size, 0))

    def sample(self, out: Floats, memory: Floats, step: Any, period: float, streams: Any) -> None:
        out[:, 0] += self.force


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    return write_module(tmp_path, monkeypatch, CODE)


def test_a_factory_gives_a_wind_or_a_whole_scenario(module: str, tmp_path: Path) -> None:
    wind = find_scenario(f"{module}:Push")
    (tmp_path / "push.toml").write_text(f'wind = "{module}:Push"', encoding="utf-8")
    assert wind == find_scenario("push.toml") == find_scenario(f'{{"wind": "{module}:Push"}}')
    assert scenario_hash(wind) != scenario_hash(Scenario())
    noisy = find_scenario(f"{module}:noisy")
    assert len(noisy.wind.models) == 2
    assert noisy.sensors
    with pytest.raises(ValueError, match="number must return a Scenario or a wind model, not 3"):
        find_scenario(f"{module}:number")
    assert as_scenario(Push(0.5)).wind.models[0].force == 0.5
    with pytest.raises(TypeError, match="a scenario must be a Scenario, its name, its fields or a wind model, not 3"):
        as_scenario(3)


def test_results_in_own_winds_are_never_confused_or_cached(module: str) -> None:
    weak, strong = Scenario(wind=Push(0.1), duration=1.0), Scenario(wind=Push(0.5), duration=1.0)
    comparison = compare({"one": ADRC("matched")}, {"weak": weak, "strong": strong}, 1)
    weak_rmse, strong_rmse = comparison.table["rmse"]
    assert weak_rmse < strong_rmse
    data = json.dumps(comparison.table.attrs)
    assert "Push object" in data
    assert " at 0x" not in data
    for scenario in (weak, find_scenario(f"{module}:Push"), Scenario(wind=[OrnsteinUhlenbeck(0.1), Push(0.1)])):
        assert own_models(scenario)
        assert Job(load_learner("adrc-paper"), scenario, 1, 0).key() is None
    assert not own_models(SCENARIOS["storm"])


def test_three_lines_of_python_write_a_report_of_objects(tmp_path: Path) -> None:
    scenarios = [Scenario(wind=Push(0.2), duration=1.0), Scenario(duration=1.0)]
    report = evaluate([controller("lqr"), "flatness"], scenarios, tmp_path, episodes=2, replay=1)
    assert report.comparison.policies == ("OutputFeedback", "flatness")
    assert list(report.comparison.scenarios) == ["scenario 1", "scenario 2"]
    assert {path.name for path in tmp_path.iterdir()} == set(report.files)
    assert "OutputFeedback" in (tmp_path / "comparison.md").read_text(encoding="utf-8")
    assert "2 episodes are too few" in str(report)
    with pytest.raises(ValueError, match="out must be a folder that can be written, not"):
        evaluate(["lqr"], ["calm"], tmp_path / "report.html", episodes=1)


def test_an_own_wind_that_fails_is_refused_before_anything_flies(module: str) -> None:
    with pytest.raises(ValueError, match=r"the scenario .*:Failing does not run: KeyError: 'x' \(own_code_\d+\.py"):
        compare(["lqr"], [f"{module}:Failing"], 1)


def test_training_settings_keep_the_factory_of_a_wind(module: str, tmp_path: Path) -> None:
    (tmp_path / "push.json").write_text(f'{{"wind": "{module}:Push"}}', encoding="utf-8")
    settings = TrainSettings(scenarios=(f"{module}:Push", "push.json"), num_envs=4)
    (tmp_path / "settings.json").write_text(json.dumps(to_mapping(settings)), encoding="utf-8")
    again = read_settings("settings.json")
    assert again == settings
    assert again.scenarios[0] == f"{module}:Push"
    assert make_env(again).reset().shape == (4, 36)  # type: ignore[union-attr]


def test_the_reward_of_a_scenario_is_used_unless_the_settings_give_another() -> None:
    own = {"task": {"reward": {"tracking": 1.0, "upright": 0.0, "yaw": 0.0, "effort": 0.0, "tip": 0.0}}}

    def reward(**settings: Any) -> RewardWeights:
        env: Any = make_env(from_mapping({"num_envs": 16, **settings}, "test"))
        return env.env.unwrapped.world.task.reward  # type: ignore[no-any-return]

    assert reward(scenarios=[own]).tip == 0.0
    assert reward(scenarios=["calm"]) == RewardWeights()
    assert reward(scenarios=[own], reward={"tip": 0.3}) == RewardWeights(tip=0.3)
