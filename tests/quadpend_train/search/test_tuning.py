"""The search for gains stays in its bounds, continues, and the scores beside the gains can be reproduced."""

import json
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_baselines.controllers.controller import Hanging, mirror_simulation
from quadpend_baselines.gains import gains_for, tuned
from quadpend_gym import Simulation
from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.policies.loading import load_policy
from quadpend_train.search import tuning
from tests.helpers.bad_input import assert_refused
from tests.helpers.scenarios import shorten_scenarios


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [(name, "paper") for name in tuning.SEARCH_SPACES]
    + [(name, vehicle) for name in tuning.HUMMINGBIRD_SPACES for vehicle in ("hummingbird", "crazyflie")],
)
def test_the_gains_are_within_the_ranges_of_the_search(name: str, vehicle: str) -> None:
    simulation = Simulation(vehicle=vehicle)
    own, ranges = tuning.search_space(name, simulation)
    assert vehicle == "crazyflie" or own == gains_for(name, simulation)
    for path, (low, high) in ranges.items():
        assert low <= attrgetter(path)(own) <= high, path


def test_gains_with_too_small_a_delay_margin_do_not_fly(monkeypatch: pytest.MonkeyPatch) -> None:
    search = tuning.Search("lqg", ("flight_training_wind",), 1)
    monkeypatch.setattr(tuning, "fly", None)
    walks = {"estimator.force_walk": 1.12, "estimator.bob_force_walk": 7.4e-5, "estimator.torque_noise": 0.0014}
    trial = SimpleNamespace(params={"effort": 0.01, **walks})
    assert 2000.0 < search.loss(trial) < 2500.0


def test_a_search_continues_and_its_result_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """For a hanging pendulum."""
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.setattr(tuning, "CHOICE_EPISODES", 2)
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    options = ["tune", "lqr", "--episodes", "2", "--scenarios", "load_windy", "--out", str(tmp_path)]
    for trials in (2, 3, 3):
        main([*options, "--trials", str(trials)])
    search = tuning.Search("lqr", ("load_windy",), 2)
    made = search.open(tmp_path / "trials.log").trials
    assert made[0].params == pytest.approx(search.start)
    assert len({json.dumps(trial.params) for trial in made}) == len(made) == 3
    found = json.loads((tmp_path / "lqr.json").read_text(encoding="utf-8"))
    assert found["gains"] in [tuning.rounded(trial.params) for trial in made]
    assert found["loss"] <= found["loss of the present gains"]
    assert found["survival and penalised rmse"]["load_windy"][0] == 100.0
    assert set(found["gains"]) == set(tuning.SEARCH_SPACES["lqr"])
    assert_refused(lambda: load_policy(f"lqi:{tmp_path / 'lqr.json'}"), "has the gains of lqr, not of lqi", ValueError)
    assert '"score"' in capsys.readouterr().out


def test_a_scenario_of_ones_own_is_tuned_for_and_its_changes_begin_a_new_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tuning, "CHOICE_EPISODES", 2)
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    mine = Scenario(wind="breeze", duration=1.0, name="mine")
    search, file = tuning.Search("lqr", [mine], 2), tmp_path / "trials.log"
    found = tuning.tune(search, search.open(file), 1, tmp_path)
    assert found["scenarios"] == [*found["survival and penalised rmse"]] == ["mine"]
    assert len(search.open(file).trials) == 1
    for other in (replace(mine, wind="windy"), mine.with_vehicle("hummingbird")):
        assert not tuning.Search("lqr", [replace(other, name="mine")], 2).open(file).trials[0].state.is_finished()


@pytest.mark.parametrize(
    ("name", "scenarios", "sentence"),
    [
        ("pid", ("calm",), "no controller 'pid'"),
        ("lqr", ("windy", "storm@racer"), "scenarios cannot be 'storm@racer', which is held out"),
        ("lqr", ("load_windy", "windy"), "must agree in the side of the pendulum"),
        ("lqr", ("recovery", "windy"), "must agree in the side of the pendulum"),
    ],
)
def test_searches_that_make_no_sense_are_refused(name: str, scenarios: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        tuning.Search(name, scenarios)


@pytest.mark.parametrize("name", tuned())
def test_the_score_beside_the_gains_can_be_reproduced(name: str) -> None:
    scores = [rmse for _, rmse in tuning.score(controller(name), scenarios=tuned()[name].scenarios).values()]
    assert np.mean(scores) == pytest.approx(tuned()[name].score, abs=0.5)


@pytest.mark.parametrize("name", tuned("hanging"))
def test_the_score_of_a_hanging_pendulum_can_be_reproduced(name: str) -> None:
    policy = Hanging(controller(name, mirror_simulation(Simulation())))
    scores = [rmse for _, rmse in tuning.score(policy, scenarios=tuned("hanging")[name].scenarios).values()]
    assert np.mean(scores) == pytest.approx(tuned("hanging")[name].score, abs=0.5)
