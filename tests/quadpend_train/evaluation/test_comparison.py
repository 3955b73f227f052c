"""The comparison is fair, its intervals are right, and the commands that make it run."""

import json
from pathlib import Path

import numpy as np
import pytest

from quadpend_baselines import ADRC
from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import MEASURES, compare, differences, summarise
from quadpend_train.evaluation.episodes import run_episodes
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.reports.tables import markdown, verdicts
from tests.helpers.policies import BiasedADRC, ZeroThrust, synthetic_results


def test_every_policy_meets_the_same_episodes() -> None:
    first, again = run_episodes([ADRC()], "windy", 5), run_episodes([ADRC()], "windy", 5)
    np.testing.assert_array_equal(first.error, again.error)
    other = run_episodes([ADRC("matched")], "windy", 5)
    np.testing.assert_allclose(first.error[..., 0], other.error[..., 0], atol=1e-3)
    fewer = run_episodes([ADRC()], "windy", 3)
    np.testing.assert_array_equal(first.error[:, :3], fewer.error)


def test_a_planted_difference_is_found_inside_its_interval() -> None:
    """One policy is 10 mm worse on average, by an amount that varies from episode to episode."""
    random = np.random.default_rng(0)
    hits = 0
    for _ in range(40):
        base = synthetic_results(random.normal(0.1, 0.03, 200))
        worse = synthetic_results(base.rmse[0] + random.normal(0.01, 0.02, 200))
        _, low, high = differences(worse, base)["penalised_rmse"]
        hits += low <= 10.0 <= high
        assert high - low < 6.5  # pairing removes the episodes' own spread
    assert hits >= 35


def test_a_policy_that_holds_a_distance_is_that_much_worse() -> None:
    aside, honest = run_episodes([BiasedADRC(0.03)], "hover", 20), run_episodes([BiasedADRC(0.0)], "hover", 20)
    assert differences(aside, honest)["settled_rmse"].value == pytest.approx(30.0, abs=0.05)


def test_equal_policies_have_no_winner() -> None:
    comparison = compare({"one": [ADRC()], "two": [ADRC()]}, ["calm"], episodes=10)
    (verdict,) = verdicts(comparison)
    assert verdict == (
        "In calm, two and one cannot be told apart: RMSE where both survive different by 0.00 mm [0.00, 0.00],"
        " survival different by 0.00 points [-16.33, 16.33]."
    )


def test_a_verdict_is_that_of_the_duel() -> None:
    """Amounts lie in their intervals, and what is not significant beside the other tests is not claimed."""
    comparison = compare(
        {"honest": [BiasedADRC(0.0)], "aside": [BiasedADRC(0.03)], "falling": [ZeroThrust()]}, ["hover"], 20
    )
    aside, falling = verdicts(comparison)
    assert aside.startswith("In hover, aside loses to honest: RMSE where both survive higher by ")
    value, low, high = compare_pair(comparison, "aside", "honest").bouts["hover"].rmse
    assert f"higher by {value:.1f} mm [{low:.1f}, {high:.1f}], survival different by 0.00 points [" in aside
    assert falling.startswith(
        "In hover, falling loses to honest: RMSE where both survive unknown, survival lower by 100.0 "
    )


def test_a_fall_shows_in_survival_and_counts_as_a_metre() -> None:
    """It never drops out of the penalised RMSE, however little was flown, and never enters that of survivors."""
    flights = run_episodes([ZeroThrust()], "calm", 10)
    assert not flights.survived.any()
    assert (flights.steps < 100).all()
    np.testing.assert_array_equal(flights.penalised_rmse, 1.0)
    summary = summarise(flights)
    assert summary["survival"].value == 0.0
    assert summary["survival"].high > 0.0
    assert summary["penalised_rmse"].value == summary["iqm"].value == 1000.0
    assert np.isnan(summary["rmse_of_survivors"].value)
    assert np.isnan(summary["settled_rmse"].value)
    half = synthetic_results([0.1, 0.2], [True, False])
    assert summarise(half)["penalised_rmse"].value == pytest.approx(550.0)
    assert summarise(half)["rmse_of_survivors"].value == pytest.approx(100.0)


def test_flights_agree_with_their_errors() -> None:
    flights = run_episodes([ADRC()], "storm", 20)
    assert 0 < flights.survived.sum() < 20
    assert flights.error.dtype == np.float32
    np.testing.assert_array_equal((~np.isnan(flights.error)).sum(axis=-1), flights.steps)
    np.testing.assert_array_equal(flights.steps == 1000, flights.survived)
    np.testing.assert_allclose(np.sqrt(np.nanmean(flights.error**2, axis=-1)), flights.rmse, rtol=1e-5)
    late = np.sqrt(np.mean(flights.error[..., 500:] ** 2, axis=-1))
    np.testing.assert_allclose(late, flights.settled_rmse, rtol=1e-5)


def test_the_evaluate_command_writes_table_data_and_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--policies", "paper=adrc-paper", "adrc-matched", "--scenarios", "windy", "--episodes", "5"]
    main(["evaluate", *arguments, "--replay", "0", "--out", str(tmp_path), "--store", str(tmp_path / "store")])
    printed = capsys.readouterr().out
    assert "adrc-matched and paper cannot be told apart: RMSE where both survive lower by" in printed
    data = json.loads((tmp_path / "comparison.json").read_text())
    assert set(data["results"]["windy"]) == {"paper", "adrc-matched"}
    assert data["results"]["windy"]["adrc-matched"]["minus_first"]["rmse_of_survivors"]["high"] < 0.0
    assert (tmp_path / "comparison.md").read_text().startswith("| scenario | policy | survival (%)")
    assert (tmp_path / "comparison.png").stat().st_size > 10_000
    with (tmp_path / "comparison.csv").open(encoding="utf-8") as file:
        said, *rows = file.read().splitlines()
    assert json.loads(said.removeprefix("# "))["scenario_hashes"] == data["scenario_hashes"]
    assert rows[0] == "scenario,policy,measure,value,low,high,unit"
    assert len(rows) == 1 + 2 * len(MEASURES)
    assert {"scenario_file", "scenario_hashes", "episodes", "seed", "origin", "code"} <= data.keys()
    assert data["origin"]["command"]


def test_train_and_evaluate_commands_work_hand_in_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = str(tmp_path / "run")
    kept = ["--out", str(tmp_path / "out"), "--store", str(tmp_path / "store")]
    main(["train", "--out", run, "--total-steps", "1024", "--num-envs", "16", "--batch-size", "256"])
    main(["evaluate", "--policies", "adrc-paper", f"ppo={run}", "--scenarios", "calm", "--episodes", "3", *kept])
    assert "ppo and adrc-paper cannot be told apart" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--policies", "nix"], "there is no policy 'nix'"),
        (["evaluate", "--scenarios", "nix"], "there is no scenario 'nix'"),
        (["evaluate", "--episodes", "0"], "episodes must be a whole number of at least 1, not 0"),
        (["evaluate", "--jobs", "0"], "jobs must be a whole number of at least 1, not 0"),
        (["evaluate", "--replay", "-1"], "replay must be a whole number of at least 0, not -1"),
        (["evaluate", "--seed", "-1"], "seed must be a whole number of at least 0, not -1"),
        (["evaluate", "--scenarios", "calm", "calm=windy"], "two scenarios have the same name"),
        (["evaluate", "--policies", "adrc-paper,adrc-paper", "x=adrc-matched,adrc-paper,adrc-paper"], "same number"),
        (["compare", "adrc-paper", "adrc-paper"], "two policies have the same name"),
        (["compare", "adrc-paper", "nix"], "there is no policy 'nix'"),
        (["train", "--scenario", "training", "--num-envs", "12"], "num_envs must be a multiple of the 8 scenarios"),
        (["train", "--settings", "nix"], "there are no settings 'nix'"),
        (["train", "--scenario", "nix"], "there is no scenario 'nix'"),
        (["train", "--resume", "nowhere"], "holds no run"),
        (["train", "--resume", "nowhere", "--seed", "9"], "give no others"),
        (["evaluate", "--policies", "a=adrc-paper", "a=adrc-matched"], "two policies have the same name"),
    ],
)
def test_mistakes_end_with_one_sentence(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_data_are_json_even_when_nobody_settles(tmp_path: Path) -> None:
    comparison = compare({"falling": [ZeroThrust()]}, ["calm"], episodes=3)
    comparison.save(tmp_path)
    data = json.loads((tmp_path / "comparison.json").read_text(), parse_constant=pytest.fail)
    assert data["results"]["calm"]["falling"]["measures"]["settled_rmse"]["value"] is None
    assert "packages" in data["origin"]


def test_markdown_table_has_a_row_for_every_cell() -> None:
    comparison = compare({"a": [ADRC()], "b": [ADRC("matched")]}, ["calm", "windy"], episodes=3)
    assert markdown(comparison).count("\n| ") == 5 + 4  # and the leaderboard
