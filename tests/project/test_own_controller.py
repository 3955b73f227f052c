"""The controller and the wind on the pages for one's own code: equal to the files, ranked by one command, and good."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.vehicles import VEHICLES
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
