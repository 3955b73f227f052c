"""Evaluation and reports work at any control period and duration, with measures in seconds."""

from pathlib import Path

import numpy as np
import pytest

from quadpend_baselines import controller
from quadpend_gym.scenarios import Scenario
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.table import cells
from quadpend_train.reports import html_page, tables
from quadpend_train.reports.replay import record_replay

SCENARIOS = {
    "default period": Scenario(duration=1.0),
    "200 Hz": Scenario(period=0.005, duration=0.5),
    "50 Hz": Scenario(period=0.02, duration=0.06),
}
POLICIES = {"adrc": "adrc-matched"}


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(POLICIES, SCENARIOS, episodes=2)


def test_a_controller_has_the_same_measures_at_any_control_period() -> None:
    scenarios = [Scenario(period=period, duration=1.0) for period in (0.02, 0.01, 0.005)]
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
