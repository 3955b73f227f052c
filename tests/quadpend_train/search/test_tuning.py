"""The search for gains stays in its bounds, continues, and the scores beside the gains can be reproduced."""

import json
import math
from pathlib import Path

import numpy as np
import optuna
import pytest

from quadpend_baselines import CONTROLLERS, controller
from quadpend_baselines.controllers.hanging import Hanging, mirror_simulation
from quadpend_baselines.controllers.vehicle_gains import gains_for, read_gain
from quadpend_baselines.gains import GAINS, HANGING_GAINS, HANGING_TUNED, TUNED, without_prediction
from quadpend_gym import Simulation
from quadpend_gym.scenarios import find_scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation.episodes import TUNING_SEED, run_episodes
from quadpend_train.search import tuning
from quadpend_train.search.shared import run_trials
from tests.helpers.scenarios import shorten_scenarios


def test_every_controller_has_gains_and_every_tuned_one_a_search_space() -> None:
    assert set(GAINS) == set(CONTROLLERS)
    assert set(TUNED) == set(tuning.SEARCH_SPACES)
    assert set(HANGING_TUNED) < set(HANGING_GAINS)


@pytest.mark.parametrize("name", tuning.SEARCH_SPACES)
def test_the_gains_are_within_the_ranges_of_the_search(name: str) -> None:
    for path, given in tuning.search_space(name, Simulation()).items():
        assert given["low"] <= read_gain(GAINS[name], path) <= given["high"], path
        assert given["low"] <= given["start"] <= given["high"], path


def test_the_concatenated_scenarios_give_the_results_of_each_scenario_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("windy", "training_upset")
    shorten_scenarios(monkeypatch, 3.0)
    found = [find_scenario(name) for name in names]
    together = tuning.fly(controller("adrc-paper"), tuning.concatenate(found, 3), found, TUNING_SEED)
    apart = [run_episodes([controller("adrc-paper")], name, 3, TUNING_SEED) for name in names]
    np.testing.assert_array_equal(together.steps, np.concatenate([results.steps[0] for results in apart]))
    np.testing.assert_array_equal(together.rmse, np.concatenate([results.rmse[0] for results in apart]))


def test_the_loss_of_an_early_fall_is_greater_than_that_of_a_late_one() -> None:
    results = run_episodes([controller("adrc-paper")], "upset", 20)
    assert not results.survived.all()
    later = results._replace(steps=np.where(results.survived, results.steps, results.steps + 100))
    assert tuning.loss(later) < tuning.loss(results)
    assert tuning.loss(results) > 1000.0 * float(results.penalised_rmse.mean())


def test_a_search_continues_and_its_result_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """For a hanging pendulum."""
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    options = ["tune", "lqr", "--episodes", "2", "--scenarios", "load_windy", "--out", str(tmp_path)]
    for trials in (2, 3, 3):
        main([*options, "--trials", str(trials)])
    search = tuning.Search("lqr", ("load_windy",), 2)
    made = search.open(str(tmp_path / "trials.log")).trials
    assert made[0].params == pytest.approx(search.start)
    assert len({json.dumps(trial.params) for trial in made}) == len(made) == 3
    found = json.loads((tmp_path / "lqr.json").read_text(encoding="utf-8"))
    assert found["survival and penalised rmse"]["load_windy"][0] == 100.0
    assert set(found["gains"]) == set(tuning.SEARCH_SPACES["lqr"])
    assert (tmp_path / "lqr.png").stat().st_size > 5000
    assert '"score"' in capsys.readouterr().out


def test_a_search_approaches_the_best_gains(tmp_path: Path) -> None:
    """With two processes that take turns, too."""
    search = tuning.Search("adrc-tuned", ("calm",), 1)

    def distance(trial: optuna.Trial) -> float:
        return sum((math.log(value / search.start[name]) - 0.3) ** 2 for name, value in trial.params.items())

    for seed in (0, 1, 0):
        study = search.open(str(tmp_path / "trials.log"), seed)
        run_trials(study, search.space, distance, len(study.trials) + 60, progress=False)
    assert study.best_value < 0.5 * float(study.trials[0].value or 0.0)


@pytest.mark.parametrize(
    ("name", "scenarios", "sentence"),
    [
        ("pid", ("calm",), "no controller 'pid'"),
        ("lqr", ("load_windy", "windy"), "must agree in the side of the pendulum"),
        ("lqr", ("recovery", "windy"), "must agree in the side of the pendulum"),
    ],
)
def test_searches_that_make_no_sense_are_refused(name: str, scenarios: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        tuning.Search(name, scenarios)


@pytest.mark.parametrize("name", [name for name in TUNED if name != "mppi"])
def test_the_score_beside_the_gains_can_be_reproduced(name: str) -> None:
    """The score of MPPI takes minutes and is not computed here; `quadpend tune mppi` computes it."""
    scores = [rmse for _, rmse in tuning.score(controller(name), scenarios=TUNED[name].scenarios).values()]
    assert np.mean(scores) == pytest.approx(TUNED[name].score, abs=0.5)


@pytest.mark.parametrize("name", HANGING_TUNED)
def test_the_score_of_a_hanging_pendulum_can_be_reproduced(name: str) -> None:
    policy = Hanging(controller(name, mirror_simulation(Simulation())))
    scores = [rmse for _, rmse in tuning.score(policy, scenarios=HANGING_TUNED[name].scenarios).values()]
    assert np.mean(scores) == pytest.approx(HANGING_TUNED[name].score, abs=0.5)


def test_gains_of_a_hanging_pendulum_are_those_of_their_controller() -> None:
    hanging = mirror_simulation(Simulation())
    assert gains_for("lqr", hanging) == HANGING_GAINS["lqr"] != gains_for("lqr")
    assert gains_for("lqr-unpredicted", hanging) == without_prediction(HANGING_GAINS["lqr"])
    assert gains_for("dual-mode", hanging).far == gains_for("flatness", hanging)
    assert gains_for("mppi", hanging) == GAINS["mppi"]
