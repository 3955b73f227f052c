"""Evaluation, reports, studies and training work at any control period and duration, with measures in seconds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_baselines.controllers.mppi import Mppi
from quadpend_baselines.gains import MppiGains
from quadpend_baselines.hybrid.fallback import update_anomaly_score
from quadpend_gym import Simulation
from quadpend_gym.scenarios import Scenario, scenario_hash
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.table import cells
from quadpend_train.reports import html_page, tables
from quadpend_train.reports.replay import record_replay
from quadpend_train.studies.search import tuning
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import HybridSettings
from tests.helpers.training import BRIEF, train_policy

FAST = Simulation(period=0.005)
SCENARIOS = {
    "default period": json.dumps({"duration": 1.0}),
    "200 Hz": json.dumps({"simulation": {"period": 0.005}, "duration": 0.5}),
    "50 Hz": json.dumps({"simulation": {"period": 0.02}, "duration": 0.06}),
}
POLICIES = {"adrc": "adrc-matched"}


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(POLICIES, SCENARIOS, episodes=2)


def test_a_controller_has_the_same_measures_at_any_control_period() -> None:
    scenarios = [Scenario(simulation=Simulation(period=period), duration=1.0) for period in (0.02, 0.01, 0.005)]
    slow, usual, fast = (run_episodes([controller("flatness")], scenario, 4) for scenario in scenarios)
    for results in (slow, fast):
        np.testing.assert_allclose(results.rmse, usual.rmse, rtol=0.1)
        np.testing.assert_allclose(results.episode_return, usual.episode_return, rtol=0.05)
    assert (fast.episode_return < 100.0).all()


def test_the_settled_rmse_is_that_of_the_second_half_of_an_episode(comparison: Comparison) -> None:
    for cell, values in cells(comparison.table).items():
        steps, error = comparison.scenarios[cell[0]].steps, comparison.errors[cell]
        assert error.shape == (1, 2, steps)
        assert (values["steps"] == steps).all()
        second_half = error[..., steps // 2 :].astype(np.float64)
        np.testing.assert_allclose(values["settled_rmse"], np.sqrt(np.mean(second_half**2, axis=-1)), rtol=1e-5)


def test_a_report_shows_scenarios_with_different_periods_and_durations(comparison: Comparison, tmp_path: Path) -> None:
    standings = leaderboard(comparison.table)
    replay = record_replay(comparison, standings, 1)
    assert replay is not None
    scenes = {name: scenes[0] for name, scenes in replay["scenarios"].items()}
    assert [scene["duration"] for scene in scenes.values()] == pytest.approx([1.0, 0.5, 0.06])
    assert [scene["rate"] for scene in scenes.values()] == pytest.approx([25.0, 25.0, 25.0])
    assert [scene["start"] for scene in scenes.values()] == [0.01, 0.005, 0.02]
    figure = tables.plot(comparison)
    assert [axis.get_xlim()[1] for axis in figure.axes[:3]] == pytest.approx([1.0, 0.5, 0.06])
    html_page.write(comparison, standings, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(text in page for text in ("0.5&nbsp;s", "200&nbsp;Hz", "0.06&nbsp;s", "50&nbsp;Hz"))


def test_a_policy_trained_at_200_hz_flies_there_and_at_the_default_period(tmp_path: Path) -> None:
    name = json.dumps({"simulation": {"period": 0.005}, "duration": 0.5})
    settings = replace(BRIEF, scenarios=(name,), eval_freq=512)
    assert make_env(settings).env.unwrapped.max_episode_steps == 100
    policy = train_policy(settings, tmp_path / "run")
    assert list(policy.card["scenarios"].values()) == [scenario_hash(Scenario(simulation=FAST, duration=0.5))]
    for scenario, steps in ((name, 100), ('{"duration": 0.5}', 50)):
        assert run_episodes([policy], scenario, 2).error.shape == (1, 2, steps)


def test_the_penalty_of_a_fall_has_the_same_weight_at_any_control_period() -> None:
    action = np.tile(np.float32([-1.0, 0.0, 0.0, 0.0]), (16, 1))

    def penalty(period: float) -> float:
        totals = []
        for failure_penalty in (0.0, 100.0):
            hybrid = HybridSettings("adrc-matched", baseline_relative_reward=True, failure_penalty=failure_penalty)
            scenario = json.dumps({"simulation": {"period": period}, "task": {"limits": {"tracking_error": 0.5}}})
            env = make_env(replace(BRIEF, scenarios=(scenario,), hybrid=hybrid, reward_scale=1.0))
            env.seed(0)
            env.reset()
            totals.append(sum(env.step(action)[1].sum() for _ in range(round(0.4 / period))))
        return float(totals[0] - totals[1])

    assert penalty(0.01) == pytest.approx(1600.0)
    assert penalty(0.005) == pytest.approx(3200.0)  # a second has twice as many rewards


def test_tuning_scores_a_controller_in_scenarios_of_another_period(tmp_path: Path) -> None:
    names = (SCENARIOS["200 Hz"], json.dumps({"simulation": {"period": 0.005}, "wind": "breeze", "duration": 0.3}))
    scores = tuning.score(controller("adrc-matched", FAST), 2, scenarios=names)
    assert list(scores) == list(names)
    assert all(survival == 100.0 and rmse < 150.0 for survival, rmse in scores.values())
    with pytest.raises(ValueError, match="scenarios must be at least one, and not 'test'"):
        tuning.tune("lqr", 1, 1, 0, tmp_path, ("test",))


def test_controllers_keep_their_time_constants_at_any_control_period() -> None:
    assert (
        Mppi(MppiGains(), FAST).horizon_simulation.period == Mppi(MppiGains(), Simulation()).horizon_simulation.period
    )
    upright, still, score = np.zeros((1, 36), np.float32), np.zeros((1, 9)), np.ones(1)
    once = update_anomaly_score(1.0, upright, still, score, np.zeros(1, np.bool_))
    for _ in range(2):
        score = update_anomaly_score(1.0, upright, still, score, np.zeros(1, np.bool_), 0.005)
    np.testing.assert_allclose(score, once)
