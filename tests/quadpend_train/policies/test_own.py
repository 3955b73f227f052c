"""Policies of the user's own code are given as module:factory, as an installed plug-in, or as objects."""

import json
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import RotorAllocation, controller
from quadpend_gym import Parameters, Simulation
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.jobs import Job
from quadpend_train.policies import own
from quadpend_train.policies.adaptation import adapt_policy, estimated_disturbance
from quadpend_train.policies.loading import load_policy, policy_fingerprint
from tests.helpers.own_code import write_module

CODE = '''
import numpy as np
from quadpend_baselines import controller


class Hover:
    """The zero action."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 4), np.float32), state


class Lqr:
    def __init__(self, simulation):
        self.simulation, self.lqr = simulation, controller("lqr", simulation)
        self.predict, self.estimated_disturbance = self.lqr.predict, self.lqr.estimated_disturbance


def gains(factor=1.0):
    assert factor == 1.0
    return Hover()


def versioned():
    policy = Hover()
    policy.fingerprint = "2"
    return policy


def returning(value):
    policy = Hover()
    policy.predict = lambda observation, state=None, episode_start=None, deterministic=True: value(observation)
    return policy


def number():
    return 3


def narrow():
    policy = Hover()
    policy.predict = lambda observation: None
    return policy


def row():
    return returning(lambda observation: (np.zeros(4, np.float32), None))


def nan():
    return returning(lambda observation: (np.full((len(observation), 4), np.nan), None))


def large():
    return returning(lambda observation: (np.full((len(observation), 4), 1.5), None))


def alone():
    return returning(lambda observation: np.zeros((len(observation), 4), np.float32))


def failing():
    return returning(lambda observation: {}["x"])


def greedy(simulation, gain):
    return Hover()
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    return write_module(tmp_path, monkeypatch, CODE)


def test_a_factory_may_take_the_simulation_and_then_learns_that_of_each_scenario(module: str) -> None:
    heavy = Simulation(Parameters(bob_mass=0.4))
    policy: Any = load_policy(f"{module}:Lqr")
    assert policy.policy.simulation == Simulation()
    adapted: Any = adapt_policy(policy, Scenario(simulation=heavy))
    assert adapted.policy.simulation == heavy
    assert isinstance(adapt_policy(policy, Scenario(actuators="rotors")), RotorAllocation)
    for name in ("Hover", "gains"):
        assert type(load_policy(f"{module}:{name}")).__name__ == "Hover"


def test_an_own_controller_flies_as_the_same_controller_of_this_package(module: str) -> None:
    own_policy, expected = load_policy(f"{module}:Lqr"), controller("lqr")
    brief = Scenario(wind="windy", duration=1.0)
    one, other = run_episodes([own_policy], brief, 2), run_episodes([expected], brief, 2)
    np.testing.assert_array_equal(one.error, other.error)
    memory = own_policy.predict(np.zeros((2, 36), np.float32))[1]
    assert estimated_disturbance(own_policy, memory).shape == (2, 9)


def test_results_of_an_own_policy_are_cached_only_with_a_fingerprint(module: str) -> None:
    def key(policies: Any) -> str | None:
        return Job(policies, SCENARIOS["calm"], 5, 0).cache_key()

    assert key(f"{module}:Hover") is None
    assert key(f"{module}:Hover,adrc-paper") is None
    assert key(f"{module}:versioned") is not None
    assert key(f"{module}:versioned") == key([load_policy(f"{module}:versioned")])
    assert key([controller("lqr")]) is None


def test_an_installed_plug_in_is_a_policy_and_never_hides_one_of_this_package(
    module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tuple(EntryPoint(name, f"{module}:Hover", own.PLUGINS) for name in ("my-hover", "flatness"))
    monkeypatch.setattr(own, "_installed", lambda: installed)
    assert type(load_policy("flatness")).__module__.startswith("quadpend_baselines")
    with pytest.warns(UserWarning, match="the plug-in 'flatness' of .* is ignored: the name is taken"):
        assert type(load_policy("my-hover")).__name__ == "Hover"
    with pytest.warns(UserWarning, match="ignored"):
        assert policy_fingerprint("my-hover") == policy_fingerprint(f"{module}:Hover")


def test_one_command_ranks_an_own_controller_in_a_report_with_a_replay(module: str, tmp_path: Path) -> None:
    arguments = ["--scenarios", 'brief={"duration": 1.0}', "--episodes", "2", "--replay", "1"]
    main(["evaluate", "lqr", f"mine={module}:Lqr", *arguments, "--out", "out", "--cache", "cache"])
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert page.count('"fell": null') == 2
    data = json.loads((tmp_path / "out/comparison.json").read_text(encoding="utf-8"))
    assert data["policies"]["mine"] == [policy_fingerprint(f"{module}:Lqr")]
    assert data["results"]["brief"]["mine"]["metrics"]["survival"]["value"] == 100.0


def test_the_card_of_an_own_policy_names_its_factory(module: str, capsys: pytest.CaptureFixture[str]) -> None:
    main(["card", f"{module}:Hover", "--json"])
    card = json.loads(capsys.readouterr().out)
    assert card["factory"] == policy_fingerprint(f"{module}:Hover")
    assert (card["type"], card["description"], card["results"]) == ("Hover", "The zero action.", "not cached")


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("number", "number is no policy but 3"),
        ("narrow", r"narrow has a predict\(observation\)"),
        ("row", r"does not fit the scenario calm: action must have shape \(2, 4\), not \(4,\)"),
        ("nan", "must be four numbers in"),
        ("large", "must be four numbers in"),
        ("alone", "predict returned ndarray, not a tuple"),
        ("failing", r"does not fit the scenario calm: KeyError: 'x' \(own_code_\d+\.py, line \d+\)"),
    ],
)
def test_a_bad_policy_is_refused_before_it_flies_in_one_sentence_with_the_protocol(
    policy: str, message: str, module: str
) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        compare([f"{module}:{policy}"], ["calm"], 2)
    assert str(refused.value).endswith(own.PROTOCOL)
    if policy not in ("number", "narrow"):
        with pytest.raises(ValueError, match=message):
            compare({policy: load_policy(f"{module}:{policy}")}, ["calm"], 2)


def test_a_factory_that_needs_more_than_the_simulation_is_refused(module: str) -> None:
    with pytest.raises(ValueError, match=r"must be callable without arguments or with the simulation alone, not as \("):
        load_policy(f"{module}:greedy")
