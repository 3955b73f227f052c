"""Comparisons are fair, their intervals are correct, and the commands for them run."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from quadpend_baselines import ADRC
from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.evaluation.table import COLUMNS, KEYS, METRICS, cells, differences, summarise, values_of
from quadpend_train.reports.report import evaluate
from quadpend_train.reports.tables import markdown, sentences
from tests.helpers.policies import BiasedADRC, ZeroThrust, synthetic_comparison, synthetic_results
from tests.helpers.scenarios import short


def test_every_policy_runs_through_the_same_episodes() -> None:
    windy = short("windy", 3.0)
    first, again = run_episodes([ADRC()], windy, 5), run_episodes([ADRC()], windy, 5)
    np.testing.assert_array_equal(first.error, again.error)
    other = run_episodes([ADRC("matched")], windy, 5)
    np.testing.assert_allclose(first.error[..., 0], other.error[..., 0], atol=1e-3)
    fewer = run_episodes([ADRC()], windy, 3)
    np.testing.assert_array_equal(first.error[:, :3], fewer.error)


def test_the_interval_of_a_known_difference_covers_it() -> None:
    """One policy is 10 mm worse on average, by an amount that varies from episode to episode."""
    random = np.random.default_rng(0)
    covered = 0
    for _ in range(40):
        base = synthetic_results(random.normal(0.1, 0.03, 200))
        worse = synthetic_results(base.rmse[0] + random.normal(0.01, 0.02, 200))
        _, low, high = differences(values_of(worse), values_of(base))["penalised_rmse"]
        covered += low <= 10.0 <= high
        assert high - low < 6.5  # pairing removes the variance of the episodes
    assert covered >= 35


def test_a_constant_offset_is_the_difference_of_the_settled_rmse() -> None:
    biased, unbiased = (values_of(run_episodes([BiasedADRC(offset)], "hover", 20)) for offset in (0.03, 0.0))
    assert differences(biased, unbiased)["settled_rmse"].value == pytest.approx(30.0, abs=0.05)


def test_sentences_agree_with_the_pairwise_comparison() -> None:
    comparison = compare(
        {"unbiased": [BiasedADRC(0.0)], "biased": [BiasedADRC(0.03)], "falling": [ZeroThrust()]}, ["hover"], 20
    )
    biased, falling = sentences(comparison)
    assert biased.startswith("unbiased beats biased in 1 of 1 scenario (hover) and loses in none; overall, its")
    assert falling.startswith("unbiased beats falling in 1 of 1 scenario (hover)")
    value, low, high = compare_pair(comparison.table, "biased", "unbiased").results["hover"].penalised_rmse
    assert f"lower by {value:.0f} mm, 95 % interval {low:.0f} to {high:.0f}" in biased or high < 20.0


def test_a_fall_counts_as_one_metre_in_the_penalised_rmse_and_not_in_that_of_survivors() -> None:
    """An early fall is in the penalised RMSE however few steps it has, and never in the RMSE of survivors."""
    results = run_episodes([ZeroThrust()], "calm", 10)
    assert not results.survived.any()
    assert (results.steps < 100).all()
    np.testing.assert_array_equal(results.penalised_rmse, 1.0)
    summary = summarise(values_of(results))
    assert summary["survival"].value == 0.0
    assert summary["survival"].high > 0.0
    assert summary["penalised_rmse"].value == summary["iqm"].value == 1000.0
    assert np.isnan(summary["rmse_of_survivors"].value)
    assert np.isnan(summary["settled_rmse"].value)
    half = values_of(synthetic_results([0.1, 0.2], [True, False]))
    assert summarise(half)["penalised_rmse"].value == pytest.approx(550.0)
    assert summarise(half)["rmse_of_survivors"].value == pytest.approx(100.0)


def test_metrics_agree_with_the_errors_of_the_steps() -> None:
    results = run_episodes([ADRC()], "storm", 20)
    assert 0 < results.survived.sum() < 20
    assert results.error.dtype == np.float32
    np.testing.assert_array_equal((~np.isnan(results.error)).sum(axis=-1), results.steps)
    np.testing.assert_array_equal(results.steps == 1000, results.survived)
    np.testing.assert_allclose(np.sqrt(np.nanmean(results.error**2, axis=-1)), results.rmse, rtol=1e-5)
    late = np.sqrt(np.mean(results.error[..., 500:] ** 2, axis=-1))
    np.testing.assert_allclose(late, results.settled_rmse, rtol=1e-5)


def test_the_table_has_a_row_for_each_episode_and_its_csv_is_read_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["paper=adrc-paper", "adrc-matched", "--scenarios", "windy", "--episodes", "5"]
    main(["evaluate", *arguments, "--replay", "0", "--out", str(tmp_path), "--cache", str(tmp_path / "cache")])
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
    data = json.loads((tmp_path / "comparison.json").read_text())
    assert data["results"]["windy"]["adrc-matched"]["differences_from_first"]["rmse_of_survivors"]["high"] < 0.0
    assert (tmp_path / "comparison.md").read_text().startswith("| scenario | policy | survival (%)")
    assert data["provenance"]["command"]


def test_values_have_an_axis_for_training_seeds() -> None:
    results = synthetic_results(np.arange(6.0).reshape(2, 3))
    table = synthetic_comparison(learner=[results]).table
    np.testing.assert_array_equal(cells(table)["s0", "learner"]["rmse"], results.rmse)


def test_evaluate_takes_the_run_folder_of_train(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = str(tmp_path / "run")
    folders = ["--out", str(tmp_path / "out"), "--cache", str(tmp_path / "cache")]
    main(["train", "--out", run, "--total-timesteps", "1024", "--num-envs", "16", "--batch-size", "256"])
    main(["evaluate", "adrc-paper", f"ppo={run}", "--scenarios", '{"duration": 1.0}', "--episodes", "3", *folders])
    assert "ppo is not distinguishable from adrc-paper" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "nix"], "there is no policy 'nix'"),
        (["evaluate", "--scenarios", "nix"], "there is no scenario 'nix'"),
        (["evaluate", "--episodes", "0"], "episodes must be a whole number from 1 to 100000, not 0"),
        (["evaluate", "--jobs", "0"], "jobs must be at least 1, not 0"),
        (["evaluate", "--replay", "-1"], "replay must be a whole number from 0 to 1000, not -1"),
        (["evaluate", "--seed", "-1"], "seed must be a whole number from 0 to"),
        (["evaluate", "--scenarios", "calm", "calm=windy"], "two scenarios have the name 'calm'"),
        (["evaluate", "adrc-paper,adrc-paper", "x=adrc-matched,adrc-paper,adrc-paper"], "same number"),
        (
            ["train", "--scenarios", "training", "--num-envs", "12"],
            "num_envs must be a multiple of the number of scenarios, 8",
        ),
        (["train", "--settings", "nix"], "settings must be the path of a file or one of apg, fast"),
        (["train", "--scenarios", "nix"], "there is no scenario 'nix'"),
        (["train", "--resume", "nowhere"], "contains no run"),
        (["train", "--resume", "nowhere", "--out", "x"], "give no --out with it"),
        (["train", "--resume", "nowhere", "--settings", "ppo"], "give no --settings with it"),
        (["evaluate", "a=adrc-paper", "a=adrc-matched"], "two policies have the same name"),
    ],
)
def test_wrong_input_ends_with_one_sentence_and_status_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_nan_becomes_null_in_json(tmp_path: Path) -> None:
    evaluate({"falling": [ZeroThrust()]}, ["calm"], tmp_path, episodes=3, replay=0)
    data = json.loads((tmp_path / "comparison.json").read_text(), parse_constant=pytest.fail)
    assert data["results"]["calm"]["falling"]["metrics"]["settled_rmse"]["value"] is None


def test_the_markdown_table_has_a_row_for_every_scenario_and_policy() -> None:
    scenarios = {name: short(name, 1.0) for name in ("calm", "windy")}
    comparison = compare({"a": [ADRC()], "b": [ADRC("matched")]}, scenarios, episodes=3)
    assert markdown(comparison, leaderboard(comparison.table)).count("\n| ") == 5 + 4  # and the leaderboard
