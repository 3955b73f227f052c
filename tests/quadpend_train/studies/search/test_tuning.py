"""The search for gains stays in its bounds, continues, and the scores beside the gains can be reproduced."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import CONTROLLERS, controller
from quadpend_baselines.controllers.hanging import Hanging, mirror_simulation
from quadpend_baselines.controllers.vehicle_gains import gains_for
from quadpend_baselines.gains import GAINS, HANGING_GAINS, HANGING_TUNED, TUNED, LqrGains, without_prediction
from quadpend_gym import Simulation
from quadpend_gym.scenarios import SETS
from quadpend_train.cli.main import main
from quadpend_train.evaluation.episodes import TUNING_SEED, run_episodes
from quadpend_train.studies.search import tuning
from tests.helpers.scenarios import shorten_scenarios


def test_every_controller_has_gains_and_every_tuned_one_a_search_space() -> None:
    assert set(GAINS) == set(CONTROLLERS)
    assert set(TUNED) == set(tuning.SEARCH_SPACES)
    assert set(HANGING_TUNED) < set(HANGING_GAINS)


@pytest.mark.parametrize("name", tuning.SEARCH_SPACES)
def test_every_gain_of_a_search_space_exists_and_is_within_its_bounds(name: str) -> None:
    for path, (low, high, first) in tuning.SEARCH_SPACES[name].items():
        gains = GAINS[name]
        for part in path.split("."):
            gains = getattr(gains, part)
        assert low <= gains <= high, path
        assert low <= first <= high, path


def test_replace_gains_replaces_nested_fields_only() -> None:
    gains = tuning.replace_gains(LqrGains(), {"position": 0.5, "estimator.noise": 0.01})
    assert (gains.position, gains.estimator.noise) == (0.5, 0.01)
    assert (gains.velocity, gains.estimator.force_walk) == (LqrGains().velocity, LqrGains().estimator.force_walk)


def test_the_concatenated_scenarios_give_the_results_of_each_scenario_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("windy", "training_upset")
    monkeypatch.setitem(SETS, "training", names)
    shorten_scenarios(monkeypatch, 3.0)
    together = tuning.run_training_scenarios(controller("adrc-paper"), tuning.training_scenarios(3), TUNING_SEED)
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
    monkeypatch.setitem(SETS, "training", ("calm",))
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    options = ["tune", "adrc-tuned", "--episodes", "2", "--out", str(tmp_path)]
    main([*options, "--trials", "2"])
    first = tuning.search("adrc-tuned", 2, 2, 0, tmp_path).trials
    main([*options, "--trials", "3"])
    trials = tuning.search("adrc-tuned", 3, 2, 0, tmp_path).trials
    assert [trial.params for trial in trials[:2]] == [trial.params for trial in first]
    assert trials[0].params == {path: begin for path, (_, _, begin) in tuning.SEARCH_SPACES["adrc-tuned"].items()}
    assert len({json.dumps(trial.params) for trial in trials}) == 3
    found = json.loads((tmp_path / "adrc-tuned.json").read_text(encoding="utf-8"))
    assert found["command"] == "quadpend tune adrc-tuned --trials 3 --episodes 2 --seed 0"
    assert set(found["gains"]) == set(tuning.SEARCH_SPACES["adrc-tuned"])
    assert '"score"' in capsys.readouterr().out


def test_an_interrupted_search_gives_the_result_of_an_uninterrupted_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[float] = []

    def distance(policy: Any, *_: Any) -> float:
        flown.append(policy.gains.damping)
        return abs(policy.gains.damping - 0.7)

    def interrupted(policy: Any, *_: Any) -> float:
        if len(flown) in interruptions:
            interruptions.remove(len(flown))
            raise KeyboardInterrupt
        return distance(policy)

    monkeypatch.setattr(tuning, "loss", lambda loss: loss)
    monkeypatch.setattr(tuning, "training_scenarios", lambda *_: None)
    monkeypatch.setattr(tuning, "run_training_scenarios", distance)
    whole = tuning.search("adrc-tuned", 30, 1, 0, tmp_path / "whole")
    monkeypatch.setattr(tuning, "run_training_scenarios", interrupted)
    flown.clear()
    interruptions = [0, 7, 8, 25]
    for _ in range(4):
        with pytest.raises(KeyboardInterrupt):
            tuning.search("adrc-tuned", 30, 1, 0, tmp_path / "parts")
    resumed = tuning.search("adrc-tuned", 30, 1, 0, tmp_path / "parts")
    assert len(flown) == 30
    assert [(trial.params, trial.value) for trial in resumed.trials] == [
        (trial.params, trial.value) for trial in whole.trials
    ]
    (one,), (other,) = ([*(tmp_path / folder).iterdir()] for folder in ("whole", "parts"))
    assert (one.name, one.read_text()) == (other.name, other.read_text())


@pytest.mark.parametrize("damaged", ["", "{}}", '{"trials": 3}', '{"trials": [{"gains": {}}]}'])
def test_a_damaged_file_of_trials_is_refused_by_name(tmp_path: Path, damaged: str) -> None:
    (tmp_path / "lqr.trials.json").write_text(damaged)
    with pytest.raises(ValueError, match=r"lqr.trials.json is (damaged|not valid JSON)"):
        tuning._Losses(tmp_path / "lqr.trials.json")


@pytest.mark.parametrize(("name", "trials", "sentence"), [("pid", 1, "no controller 'pid'"), ("lqr", 0, "trials must")])
def test_wrong_arguments_of_tune_are_refused(tmp_path: Path, name: str, trials: int, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        tuning.tune(name, trials, 1, 0, tmp_path)


@pytest.mark.parametrize("name", [name for name in TUNED if name != "mppi"])
def test_the_score_beside_the_gains_can_be_reproduced(name: str) -> None:
    """The score of MPPI takes minutes and is not computed here; `quadpend tune mppi` computes it."""
    scores = [rmse for _, rmse in tuning.score(controller(name), scenarios=TUNED[name].scenarios).values()]
    assert np.mean(scores) == pytest.approx(TUNED[name].score, abs=0.5)


@pytest.mark.parametrize("name", HANGING_TUNED)
def test_the_score_of_a_hanging_pendulum_can_be_reproduced(name: str) -> None:
    policy = Hanging(controller(name), Simulation())
    scores = [rmse for _, rmse in tuning.score(policy, scenarios=HANGING_TUNED[name].scenarios).values()]
    assert np.mean(scores) == pytest.approx(HANGING_TUNED[name].score, abs=0.5)


def test_gains_of_a_hanging_pendulum_are_those_of_their_controller() -> None:
    hanging = mirror_simulation(Simulation())
    assert gains_for("lqr", hanging) == HANGING_GAINS["lqr"] != gains_for("lqr")
    assert gains_for("lqr-unpredicted", hanging) == without_prediction(HANGING_GAINS["lqr"])
    assert gains_for("dual-mode", hanging).far == gains_for("flatness", hanging)
    assert gains_for("mppi", hanging) == GAINS["mppi"]


@pytest.mark.parametrize("scenarios", [("load_windy", "windy"), ("recovery", "windy")])
def test_scenarios_of_different_tasks_are_not_tuned_together(tmp_path: Path, scenarios: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="must agree in the side of the pendulum"):
        tuning.tune("lqr", 1, 1, 0, tmp_path, scenarios)


def test_gains_are_tuned_for_a_hanging_pendulum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    found = tuning.tune("lqr", 2, 2, 0, tmp_path, ("load_windy",))
    assert found["survival and penalised rmse"]["load_windy"][0] == 100.0


def test_processes_that_share_a_storage_continue_one_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SETS, "training", ("calm",))
    shorten_scenarios(monkeypatch, 1.0)
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    storage = str(tmp_path / "search.log")
    options = ["tune", "adrc-tuned", "--episodes", "2", "--out", str(tmp_path / "out"), "--storage", storage]
    for trials in (2, 3, 3):
        main([*options, "--trials", str(trials)])
        assert len(tuning.open_search("adrc-tuned", 2, 0, ("training",), storage).trials) == trials
    found = json.loads((tmp_path / "out/adrc-tuned.json").read_text(encoding="utf-8"))
    assert found["command"].endswith(f"--trials 3 --episodes 2 --seed 0 --storage {storage}")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"adrc-tuned.json", "adrc-tuned.png"}
    assert not tuning.open_search("adrc-tuned", 2, 1, ("training",), storage).trials  # another search
