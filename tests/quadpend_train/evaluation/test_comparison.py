"""Comparisons are fair, their intervals are correct, and the commands for them run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from quadpend_baselines import controller
from quadpend_gym.physics.state import ACTION_SIZE, THRUST
from quadpend_gym.scenarios import Scenario
from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.metrics import COLUMNS, KEYS, METRICS, falls, summarise, values_of
from tests.helpers.policies import ZeroThrust, synthetic_results
from tests.helpers.scenarios import short


def test_every_policy_runs_through_the_same_episodes() -> None:
    windy = short("windy", 3.0)
    first, again = (
        run_episodes([controller("adrc-paper")], windy, 5),
        run_episodes([controller("adrc-paper")], windy, 5),
    )
    np.testing.assert_array_equal(first.error, again.error)
    other = run_episodes([controller("adrc-matched")], windy, 5)
    np.testing.assert_allclose(first.error[..., 0], other.error[..., 0], atol=1e-3)
    fewer = run_episodes([controller("adrc-paper")], windy, 3)
    np.testing.assert_array_equal(first.error[:, :3], fewer.error)


def test_a_controller_has_the_same_measures_at_any_control_period() -> None:
    scenarios = [Scenario(period=period, duration=1.0) for period in (0.02, 0.01, 0.005)]
    slow, usual, fast = (run_episodes([controller("flatness")], scenario, 4) for scenario in scenarios)
    for results in (slow, fast):
        np.testing.assert_allclose(results.rmse, usual.rmse, rtol=0.1)
        np.testing.assert_allclose(results.episode_return, usual.episode_return, rtol=0.05)
    assert (fast.episode_return < 100.0).all()


def test_a_fall_counts_as_one_metre_in_the_penalised_rmse_and_not_in_that_of_survivors() -> None:
    """An early fall is in the penalised RMSE however few steps it has, and never in the RMSE of survivors."""
    results = run_episodes([ZeroThrust()], "calm", 10)
    assert not results.survived.any()
    assert (results.steps < 100).all()
    np.testing.assert_array_equal(results.penalised_rmse, 1.0)
    summary = summarise(values_of(results))
    assert summary["survival"].value == 0.0
    assert summary["survival"].high > 0.0
    assert summary["penalised_rmse"].value == 1000.0
    assert np.isnan(summary["rmse_of_survivors"].value)
    assert np.isnan(summary["settled_rmse"].value)
    assert falls(values_of(results)) == "10 (10 ground)"
    assert (results.action_rate == 0.0).all()
    half = values_of(synthetic_results([0.1, 0.2], [True, False]))
    assert summarise(half)["penalised_rmse"].value == pytest.approx(550.0)
    assert summarise(half)["rmse_of_survivors"].value == pytest.approx(100.0)


class Alternating(ZeroThrust):
    """A policy that changes the thrust by 0.2 in each step."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        action, sign = np.zeros((len(observation), ACTION_SIZE), np.float32), -1.0 if state is None else -state
        action[:, THRUST] = 0.1 * sign
        return action, sign


def test_the_action_rate_is_the_change_of_the_action_per_second() -> None:
    for period in (0.01, 0.005):
        results = run_episodes([Alternating()], Scenario(duration=0.2, period=period), 3)
        np.testing.assert_allclose(results.action_rate, 0.2 / period, rtol=1e-6)


def test_metrics_agree_with_the_errors_of_the_steps() -> None:
    results = run_episodes([controller("adrc-paper")], "storm", 20)
    assert 0 < results.survived.sum() < 20
    assert results.error.dtype == np.float32
    np.testing.assert_array_equal((~np.isnan(results.error)).sum(axis=-1), results.steps)
    np.testing.assert_array_equal(results.steps == 1000, results.survived)
    np.testing.assert_allclose(np.sqrt(np.nanmean(results.error**2, axis=-1)), results.rmse, rtol=1e-5)
    late = np.sqrt(np.mean(results.error[..., 500:] ** 2, axis=-1))
    np.testing.assert_allclose(late, results.settled_rmse, rtol=1e-5)


def test_errors_count_after_the_unscored_beginning_and_falls_always() -> None:
    scored = short("windy", 3.0)
    results, other = (run_episodes([controller("adrc-paper")], replace(scored, unscored=s), 5) for s in (1.0, 0.0))
    np.testing.assert_array_equal(results.error, other.error)
    np.testing.assert_allclose(results.rmse, np.sqrt(np.mean(results.error[..., 100:] ** 2, axis=-1)), rtol=1e-5)
    np.testing.assert_allclose(results.settled_rmse, results.rmse)
    fallen = run_episodes([ZeroThrust()], replace(scored, unscored=2.0), 5)
    assert not fallen.survived.any()
    assert np.isnan(fallen.rmse).all()
    np.testing.assert_array_equal(fallen.penalised_rmse, 1.0)
    with pytest.raises(ValueError, match="unscored must be less than the duration of 3 s"):
        replace(scored, unscored=3.0)


def test_the_table_has_a_row_for_each_episode_and_its_csv_is_read_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["paper=adrc-paper", "adrc-matched", "--scenarios", "windy", "--episodes", "5"]
    main(["evaluate", *arguments, "--out", str(tmp_path), "--cache", str(tmp_path / "cache")])
    assert "mine" not in capsys.readouterr().out
    table = compare({"paper": "adrc-paper", "adrc-matched": "adrc-matched"}, ["windy"], 5).table
    assert list(table.columns) == [*KEYS, *COLUMNS]
    assert table.attrs["episodes"] == len(table) / 2 == 5
    read = pd.read_csv(tmp_path / "episodes.csv", comment="#")
    pd.testing.assert_frame_equal(read, table, check_dtype=False)
    summaries = pd.read_csv(tmp_path / "comparison.csv", comment="#")
    assert len(summaries) == 2 * len(METRICS)
    paper = summaries[(summaries["policy"] == "paper") & (summaries["metric"] == "penalised_rmse")]
    assert paper["value"].item() == pytest.approx(1000.0 * table["penalised_rmse"][:5].mean())
    assert (tmp_path / "comparison.md").read_text().startswith("| scenario | policy | survival (%)")
    assert table.attrs["provenance"]["command"]
