"""The policies and the wind on the pages for one's own code: ranked by one command, and good."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from stable_baselines3 import PPO

from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train import SB3VecEnv
from quadpend_train.cli.main import main
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.policies.loading import load_policy
from tests.helpers.sources import ROOT

EXAMPLES = ROOT / "docs/examples"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the examples."""
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_one_command_ranks_the_example_in_a_report(folder: Path) -> None:
    scenarios = ['calm={"duration": 1.0}', 'turning={"wind": "turning:TurningForce", "duration": 1.0}']
    policies = ["mine:MyController", "flatness", "adrc-paper"]
    main(["evaluate", *policies, "--scenarios", *scenarios, "--episodes", "2", "--cache", "cache"])
    table = pd.read_csv(folder / "results/comparison.csv", comment="#")
    assert list(dict.fromkeys(table[table["scenario"] == "turning"]["policy"])) == policies
    assert (folder / "results/report.html").is_file()


def test_the_example_survives_and_beats_the_controller_of_the_paper_in_wind(folder: Path) -> None:
    for name in ("calm", "windy"):
        own, paper = (run_episodes([load_policy(policy)], name, 6) for policy in ("mine:MyController", "adrc-paper"))
        assert own.survived.all()
        if name == "windy":
            assert own.penalised_rmse.mean() < 0.7 * paper.penalised_rmse.mean()
        else:
            assert own.settled_rmse.max() < 1e-3


def test_the_example_handles_single_observations_new_episodes_and_other_vehicles(folder: Path) -> None:
    other = Scenario(vehicle=replace(VEHICLES["paper"], mass=0.7), period=0.005, duration=3.0)
    results = run_episodes([load_policy("mine:MyController")], other, 3)
    assert results.survived.all()
    policy = load_policy("mine:MyController").adapt(SCENARIOS["windy"])
    observation = SCENARIOS["windy"].make_vec(2, "SameStep").reset(seed=0)[0]  # type: ignore[arg-type]
    action, memory = policy.predict(observation)
    single, _ = policy.predict(observation[0])
    np.testing.assert_array_equal(single, action[0])
    restarted, _ = policy.predict(observation, 0.1 + memory, np.array([True, False]))
    assert (restarted[0] == action[0]).all()
    assert (restarted[1] != action[1]).any()


def test_the_lqg_of_the_page_survives_on_measurements_alone(folder: Path) -> None:
    pytest.importorskip("control")
    page = (ROOT / "docs/your-own-controller.md").read_text(encoding="utf-8")
    (code,) = re.findall(r'```python\n("""LQG.*?)```', page, re.DOTALL)
    (folder / "mylqg.py").write_text(code, encoding="utf-8")
    breeze, jump = (run_episodes([load_policy("mylqg:MyLqg")], name, 5) for name in ("flight_breeze", "event_jump"))
    assert breeze.survived.all()
    assert breeze.settled_rmse.mean() < 5e-3
    assert jump.survived.all()


def test_a_model_trained_at_25_hz_holds_each_action_for_four_steps(folder: Path) -> None:
    fast = replace(SCENARIOS["flight_breeze"], wind="calm", sensors=(), loop=None)
    slow = replace(fast, period=0.04, substeps=16)
    envs = SB3VecEnv(VectorHistoryWrapper(slow.make_vec(2, "SameStep"), observations=4, actions=3))  # type: ignore[arg-type]
    PPO("MlpPolicy", envs, n_steps=8, batch_size=16, device="cpu", seed=0).save("recipe.zip")
    flown = []
    for name, scenario, steps in (("held:Held", fast, 24), ("recipe.zip", slow, 6)):
        policy, env = load_policy(name).adapt(scenario), scenario.make_vec(3, "SameStep")  # type: ignore[arg-type]
        observation, memory, actions = env.reset(seed=1)[0], None, []
        for _ in range(steps):
            action, memory = policy.predict(observation, memory)
            actions.append(action)
            observation = env.step(action)[0]
        flown.append(np.array(actions))
    held, every_fourth = flown
    np.testing.assert_array_equal(held, np.repeat(held[::4], 4, axis=0))
    np.testing.assert_allclose(held[::4], every_fourth, rtol=0.0, atol=1e-5)
