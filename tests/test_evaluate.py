"""The comparison is fair, its intervals are right, and the commands that make it run."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from baselines import ADRC
from train.cli import main
from train.evaluate import Flights, compare, differences, fly, summarise
from train.report import markdown, verdicts
from train.statistics import mean, paired_proportion, proportion


class Biased:
    """ADRC that holds the bob a known distance (m) beside the reference in x."""

    def __init__(self, distance: float) -> None:
        self.distance, self.adrc = distance, ADRC("matched")

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        shifted = observation.copy()
        shifted[:, 0] -= self.distance / 0.5
        return self.adrc.predict(shifted, state, episode_start)


class Falling:
    """No thrust."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        action = np.zeros((len(observation), 4), np.float32)
        action[:, 0] = -1.0
        return action, None


def test_every_policy_meets_the_same_episodes() -> None:
    first, again = fly([ADRC()], "windy", 5), fly([ADRC()], "windy", 5)
    np.testing.assert_array_equal(first.error, again.error)
    other = fly([ADRC("matched")], "windy", 5)
    np.testing.assert_allclose(first.error[..., 0], other.error[..., 0], atol=1e-3)
    fewer = fly([ADRC()], "windy", 3)
    np.testing.assert_array_equal(first.error[:, :3], fewer.error)


def test_a_planted_difference_is_found_inside_its_interval() -> None:
    """One policy is 10 mm worse on average, by an amount that varies from episode to episode."""
    random = np.random.default_rng(0)
    hits = 0
    for _ in range(40):
        base = fly_nothing(random.normal(0.1, 0.03, 200))
        worse = fly_nothing(base.rmse[0] + random.normal(0.01, 0.02, 200))
        _, low, high = differences(worse, base)["rmse"]
        hits += low <= 10.0 <= high
        assert high - low < 6.5  # pairing removes the episodes' own spread
    assert hits >= 35


def fly_nothing(rmse: Any) -> Flights:
    rmse = np.atleast_2d(rmse)
    other = np.ones_like(rmse)
    return Flights(other > 0, rmse, other, other, other, other, other[..., np.newaxis])


def test_a_policy_that_holds_a_distance_is_that_much_worse() -> None:
    planted, honest = fly([Biased(0.03)], "hover", 20), fly([Biased(0.0)], "hover", 20)
    assert differences(planted, honest)["settled_rmse"].value == pytest.approx(30.0, abs=0.05)


def test_equal_policies_have_no_winner() -> None:
    comparison = compare({"one": [ADRC()], "two": [ADRC()]}, ["calm"], episodes=10)
    (verdict,) = verdicts(comparison)
    assert "neither closer nor worse" in verdict
    assert "neither more often nor less often" in verdict


def test_falls_show_in_survival_and_stay_in_the_rmse() -> None:
    flights = fly([Falling()], "calm", 10)
    assert not flights.survived.any()
    summary = summarise(flights)
    assert summary["survival"].value == 0.0
    assert summary["survival"].high > 0.0
    assert summary["rmse"].value > 500.0
    assert np.isnan(summary["settled_rmse"].value)


def test_intervals_are_those_of_the_books() -> None:
    successes = np.arange(100)[np.newaxis] < 93
    expected = stats.binomtest(93, 100).proportion_ci(method="wilson")
    assert proportion(successes)[1:] == (expected.low, expected.high)
    values = np.random.default_rng(0).normal(size=(1, 400))
    _, low, high = mean(values)
    half = stats.norm.ppf(0.975) * values.std() / 20.0
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.01)


def test_the_evaluate_command_writes_table_data_and_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--policies", "paper=adrc-paper", "adrc-matched", "--scenarios", "windy", "--episodes", "5"]
    main(["evaluate", *arguments, "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert "adrc-matched tracks closer by" in printed
    data = json.loads((tmp_path / "comparison.json").read_text())
    assert set(data["results"]["windy"]) == {"paper", "adrc-matched"}
    assert data["results"]["windy"]["adrc-matched"]["minus_first"]["rmse"]["high"] < 0.0
    assert (tmp_path / "comparison.md").read_text().startswith("| scenario | policy | survival (%)")
    assert (tmp_path / "comparison.png").stat().st_size > 10_000


def test_train_and_evaluate_commands_work_hand_in_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, out = str(tmp_path / "run"), str(tmp_path / "out")
    main(["train", "--out", run, "--total-steps", "1024", "--num-envs", "16", "--batch-size", "256"])
    main(["evaluate", "--policies", "adrc-paper", f"ppo={run}", "--scenarios", "calm", "--episodes", "3", "--out", out])
    assert "ppo tracks" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--policies", "nix"], "there is no policy 'nix'"),
        (["evaluate", "--scenarios", "nix"], "there is no scenario 'nix'"),
        (["evaluate", "--episodes", "0"], "episodes must be at least 1"),
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


def test_paired_survival_is_never_certain() -> None:
    """Two policies that fall in the same episodes may still differ; Agresti and Min's interval says by how much."""
    survived = np.arange(200)[np.newaxis] > 3
    value, low, high = paired_proportion(survived, survived)
    assert value == 0.0
    assert (low, high) == pytest.approx((-0.0097, 0.0097), abs=1e-4)
    better = paired_proportion(survived | True, survived)
    assert better.value == pytest.approx(4 / 200)


def test_intervals_of_a_learner_cover_its_training_seeds() -> None:
    """Five seeds that differ by 10 mm have a wider interval than one of them, in however many episodes."""
    random = np.random.default_rng(0)
    seeds = random.normal(0.1, 0.01, (5, 1)) + random.normal(0.0, 0.01, (5, 1000))
    one, five = mean(seeds[:1]), mean(seeds)
    assert one.high - one.low < 0.0015
    assert five.high - five.low > 0.005
    learner = fly([ADRC("paper"), ADRC("matched")], "windy", 4)
    np.testing.assert_array_equal(learner.error[1:], fly([ADRC("matched")], "windy", 4).error)


def test_data_are_json_even_when_nobody_settles(tmp_path: Path) -> None:
    comparison = compare({"falling": [Falling()]}, ["calm"], episodes=3)
    comparison.save(tmp_path)
    data = json.loads((tmp_path / "comparison.json").read_text(), parse_constant=pytest.fail)
    assert data["results"]["calm"]["falling"]["measures"]["settled_rmse"]["value"] is None
    assert "packages" in data["origin"]


def test_markdown_table_has_a_row_for_every_cell() -> None:
    comparison = compare({"a": [ADRC()], "b": [ADRC("matched")]}, ["calm", "windy"], episodes=3)
    assert markdown(comparison).count("\n| ") == 5
