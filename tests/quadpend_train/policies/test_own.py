"""Policies of the user's own code, given as module:factory or as objects."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import Policy, controller
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.jobs import Job
from quadpend_train.policies.conversion import PROTOCOL
from quadpend_train.policies.loading import load_policies, load_policy
from tests.helpers.own_code import write_module

CODE = '''
import gymnasium as gym
import numpy as np
from quadpend_baselines import Policy, controller


class Hover(Policy):
    """The zero action."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 4), np.float32), state


class Lqr:
    fingerprint = "2"
    made = []

    def __init__(self, simulation):
        self.made.append(simulation)
        self.predict = controller("lqr", simulation).predict


class Wall(gym.vector.VectorWrapper):
    """The observation and the distance to a wall at x = 1 m."""

    def reset(self, **options):
        observation, info = self.env.reset(**options)
        return self.beside(observation), info

    def step(self, actions):
        observation, *rest = self.env.step(actions)
        return self.beside(observation), *rest

    def beside(self, observation):
        return np.column_stack([observation, 1.0 - self.unwrapped.state.position[:, 0]])


class Avoiding(Lqr):
    def __init__(self, simulation):
        super().__init__(simulation)
        lqr = self.predict
        self.predict = lambda observation, *memory, **options: lqr(observation[:, [*range(37)][:-1]], *memory)


def beside_a_wall(simulation):
    return Avoiding(simulation), Wall


class Returning:
    def __init__(self, value):
        self.predict = lambda observation, *memory, **options: value(observation)


def number():
    return 3


def row():
    return Returning(lambda observation: (np.zeros(4, np.float32), None))


def alone():
    return Returning(lambda observation: np.zeros((len(observation), 4), np.float32))


def failing():
    return Returning(lambda observation: {}["x"])


def greedy(simulation, gain):
    return Hover()
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    return write_module(tmp_path, monkeypatch, CODE)


def test_a_factory_is_called_for_the_simulation_of_the_scenario_only(module: str) -> None:
    other = Scenario(period=0.02)
    policy: Any = load_policy(f"{module}:Lqr")
    assert policy.factory.made == []
    policy.adapt(other)
    assert policy.factory.made == [other.simulation]


def test_an_own_controller_flies_as_the_same_controller_of_this_package_also_in_a_wrapper(module: str) -> None:
    brief, names = Scenario(wind="windy", duration=1.0), ("lqr", f"{module}:Lqr", f"{module}:beside_a_wall")
    same, own, in_wrapper = (run_episodes([load_policy(name)], brief, 2).error for name in names)
    np.testing.assert_array_equal(own, same)
    np.testing.assert_array_equal(in_wrapper, same)


def test_results_of_an_own_policy_are_cached_only_with_a_fingerprint(module: str) -> None:
    def key(policies: list[Policy]) -> Path | None:
        return Job(policies, SCENARIOS["calm"], 5, 0).file(Path())

    assert key(load_policies(f"{module}:Hover,adrc-paper")) is None
    assert key(load_policies(f"{module}:Lqr")) is not None
    assert key([controller("lqr")]) is None


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("number", "3 is no policy"),
        ("row", r"does not fit the scenario calm: action must be numbers of shape \(2, 4\), not array"),
        ("alone", "predict returned ndarray, not a tuple"),
        ("failing", r"does not fit the scenario calm: KeyError: 'x' \(own_code_\d+\.py, line \d+\)"),
        ("greedy", "greedy failed: TypeError: .*missing 1 required positional argument: 'gain'"),
    ],
)
def test_a_bad_policy_is_refused_before_it_flies_in_one_sentence_with_the_protocol(
    policy: str, message: str, module: str
) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        compare([f"{module}:{policy}"], ["calm"], 2)
    assert str(refused.value).endswith(PROTOCOL)
