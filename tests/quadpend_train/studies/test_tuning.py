"""Tuning searches what it says, resumes, and the scores beside the gains are true."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_baselines import CONTROLLERS, controller
from quadpend_baselines.gains import GAINS, TUNED, LqrGains
from quadpend_baselines.policy.rollout import rollout
from quadpend_train.cli.main import main
from quadpend_train.evaluation.episodes import TUNING_SEED, collect_results, run_episodes
from quadpend_train.scenarios import SETS
from quadpend_train.studies import tuning


def test_every_controller_has_gains_and_what_was_tuned_has_a_space() -> None:
    assert set(GAINS) == set(CONTROLLERS)
    assert set(TUNED) == set(tuning.SPACES)


@pytest.mark.parametrize("name", tuning.SPACES)
def test_every_searched_gain_exists_and_lies_within_its_bounds(name: str) -> None:
    for path, (low, high, first) in tuning.SPACES[name].items():
        gains = GAINS[name]
        for part in path.split("."):
            gains = getattr(gains, part)
        assert low <= gains <= high, path
        assert low <= first <= high, path


def test_changed_replaces_nested_fields_and_leaves_the_rest() -> None:
    gains = tuning.changed(LqrGains(), {"position": 0.5, "estimator.noise": 0.01})
    assert (gains.position, gains.estimator.noise) == (0.5, 0.01)
    assert (gains.velocity, gains.estimator.force_walk) == (LqrGains().velocity, LqrGains().estimator.force_walk)


def test_a_fleet_flies_as_its_environments_do(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("windy", "training_upset")
    monkeypatch.setitem(SETS, "training", names)
    fleet: Any = tuning.Fleet(3)
    together = collect_results(rollout(controller("adrc-paper"), fleet, TUNING_SEED), 6)
    apart = [run_episodes([controller("adrc-paper")], name, 3, TUNING_SEED) for name in names]
    np.testing.assert_array_equal(together.steps, np.concatenate([flights.steps[0] for flights in apart]))
    np.testing.assert_array_equal(together.rmse, np.concatenate([flights.rmse[0] for flights in apart]))


def test_an_earlier_fall_is_a_greater_loss_than_a_later_one() -> None:
    flights = run_episodes([controller("adrc-paper")], "upset", 20)
    assert not flights.survived.all()
    later = flights._replace(steps=np.where(flights.survived, flights.steps, flights.steps + 100))
    assert tuning.lost(later) < tuning.lost(flights)
    assert tuning.lost(flights) > 1000.0 * float(flights.penalised_rmse.mean())


def test_a_search_goes_on_where_it_was_and_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(SETS, "training", ("calm",))
    monkeypatch.setattr(tuning, "SCORE_EPISODES", 2)
    options = ["tune", "adrc-tuned", "--episodes", "2", "--out", str(tmp_path)]
    main([*options, "--trials", "2"])
    first = tuning.search("adrc-tuned", 2, 2, 0, tmp_path).trials
    main([*options, "--trials", "3"])
    trials = tuning.search("adrc-tuned", 3, 2, 0, tmp_path).trials
    assert [trial.params for trial in trials[:2]] == [trial.params for trial in first]
    assert trials[0].params == {path: begin for path, (_, _, begin) in tuning.SPACES["adrc-tuned"].items()}
    assert len({json.dumps(trial.params) for trial in trials}) == 3
    found = json.loads((tmp_path / "adrc-tuned.json").read_text(encoding="utf-8"))
    assert found["command"] == "quadpend tune adrc-tuned --trials 3 --episodes 2 --seed 0"
    assert set(found["gains"]) == set(tuning.SPACES["adrc-tuned"])
    assert '"score"' in capsys.readouterr().out


@pytest.mark.parametrize(("name", "trials", "sentence"), [("pid", 1, "no controller 'pid'"), ("lqr", 0, "trials must")])
def test_what_cannot_be_tuned_is_refused(tmp_path: Path, name: str, trials: int, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        tuning.tune(name, trials, 1, 0, tmp_path)


@pytest.mark.parametrize("name", [name for name in TUNED if name != "mppi"])
def test_the_score_beside_the_gains_is_theirs(name: str) -> None:
    """MPPI's takes minutes: `quadpend tune mppi` tells it."""
    scores = [rmse for _, rmse in tuning.score(controller(name)).values()]
    assert np.mean(scores) == pytest.approx(TUNED[name].score, abs=0.5)
