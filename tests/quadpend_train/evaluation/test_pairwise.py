"""Who wins is said only where it is so: synthetic differences are found, equals have no winner."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpend_train.cli.main import main
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.pairwise import compare_all_pairs, compare_pair
from quadpend_train.reports.tables import leaderboard_table
from quadpend_train.scenarios import Scenario
from tests.helpers.policies import BiasedADRC, NoisyADRC, ZeroThrust, synthetic_results


def compared(**policies: list[EpisodeResults]) -> Comparison:
    """A comparison that nobody flew: a list of flights for each policy, one for each scenario."""
    number = len(next(iter(policies.values())))
    names = [f"s{i}" for i in range(number)]
    flights = {(names[i], policy): flown[i] for policy, flown in policies.items() for i in range(number)}
    return Comparison(tuple(policies), {name: Scenario() for name in names}, 200, 0, flights, {})


def test_a_planted_advantage_is_found_with_its_amount_in_the_interval() -> None:
    random = np.random.default_rng(0)
    base = [random.normal(0.1, 0.03, 200) for _ in range(6)]
    better = [values - random.normal(0.01, 0.01, 200) for values in base[:5]] + [
        base[5] + random.normal(0.0, 0.01, 200)
    ]
    fought = compare_pair(
        compared(a=[synthetic_results(x) for x in better], b=[synthetic_results(x) for x in base]), "a", "b"
    )
    assert fought.won(1) == ["s0", "s1", "s2", "s3", "s4"]
    assert fought.won(0) == ["s5"]
    for name in fought.won(1):
        _, low, high = fought.bouts[name].penalised_rmse
        assert -13.0 < low < high < -7.0
    assert sum(bout.rmse.low <= -10.0 <= bout.rmse.high for bout in fought.bouts.values()) >= 4
    sentence = fought.sentence()
    assert sentence.startswith(
        "a beats b in 5 of 6 scenarios (s0, s1, s2, s3, s4), loses in none and is not distinguishable in 1 (s5); over"
        " all, its penalised RMSE is lower by "
    )
    assert (
        sentence
        == compare_pair(
            compared(a=[synthetic_results(x) for x in better], b=[synthetic_results(x) for x in base]), "b", "a"
        ).sentence()
    )


def test_equals_have_no_winner() -> None:
    same = compare({"one": "adrc-paper", "two": "adrc-paper"}, ["calm", "windy"], 10)
    assert (
        compare_pair(same, "one", "two")
        .sentence()
        .startswith("one is not distinguishable from two in 2 (calm, windy); over all")
    )
    shaky = compare({"one": [NoisyADRC(1)], "two": [NoisyADRC(2)]}, ["calm", "windy", "gusts"], 20)
    assert compare_pair(shaky, "one", "two").won(0) == ["calm", "windy", "gusts"]


def test_equals_rarely_win_anything_in_many_scenarios() -> None:
    """The chance of one false victory in all 16 scenarios together is at most 5 %."""
    random = np.random.default_rng(1)
    fights = 0
    for _ in range(20):
        base = random.normal(0.1, 0.03, (16, 50))
        one, two = (
            [synthetic_results(x + random.normal(0.0, 0.01, 50), random.random(50) < 0.9) for x in base]
            for _ in range(2)
        )
        fights += len(compare_pair(compared(a=one, b=two), "a", "b").won(0)) < 16
    assert fights <= 4


@pytest.mark.parametrize("rate", [0.0025, 0.005])
def test_a_fall_by_chance_is_no_victory(rate: float) -> None:
    """Equals that fall rarely, each in episodes of its own: a fall counts as 1 m, a thousand times the rest."""
    random = np.random.default_rng(4)
    claims = 0
    for _ in range(200):
        base = random.normal(0.1, 0.03, 200)
        one, two = (
            synthetic_results(base + random.normal(0.0, 0.001, 200), random.random(200) >= rate) for _ in range(2)
        )
        claims += compare_pair(compared(a=[one], b=[two]), "a", "b").bouts["s0"].result != 0
    assert claims <= 14


def test_too_few_common_survivals_are_no_evidence_of_rmse() -> None:
    few, many = np.arange(200) < 9, np.arange(200) < 12
    for survived, result in ((few, 0), (many, 1)):
        fought = compare_pair(
            compared(
                a=[synthetic_results(np.full(200, 0.1), survived)], b=[synthetic_results(np.full(200, 0.2), survived)]
            ),
            "a",
            "b",
        )
        assert fought.won(result) == ["s0"]
        assert fought.bouts["s0"].rmse.value == pytest.approx(-100.0)
    fallen = synthetic_results(np.full(200, 0.1), survived=False)
    assert np.isnan(compare_pair(compared(a=[fallen], b=[fallen]), "a", "b").bouts["s0"].rmse.value)


def test_all_duels_of_a_comparison_are_one_family() -> None:
    """Each p-value is corrected for the tests of all pairs, and the leaderboard counts those victories."""
    random = np.random.default_rng(5)
    base = random.normal(0.1, 0.03, 200)
    flown = {name: [synthetic_results(base + random.normal(0.0005 * i, 0.005, 200))] for i, name in enumerate("abcdef")}
    comparison = compared(**flown)
    together = compare_all_pairs(comparison)
    assert len(together) == 15
    for (first, second), fought in together.items():
        alone = compare_pair(comparison, first, second).bouts["s0"]
        assert fought.bouts["s0"].p_rmse >= alone.p_rmse
        assert fought.bouts["s0"].rmse == alone.rmse
    smallest = min(together, key=lambda pair: together[pair].bouts["s0"].p_rmse)
    alone = compare_pair(comparison, *smallest).bouts["s0"]
    assert together[smallest].bouts["s0"].p_rmse == pytest.approx(15 * alone.p_rmse)
    decided = sum(len(fought.won(1)) + len(fought.won(-1)) for fought in together.values())
    assert 0 < sum(standing.wins for standing in leaderboard(comparison)) == decided < 15


def test_survival_comes_first() -> None:
    """Who tracks closely but falls loses to who tracks worse and stays up."""
    random = np.random.default_rng(2)
    close = synthetic_results(random.normal(0.02, 0.001, 200), random.random(200) < 0.8)
    loose = synthetic_results(random.normal(0.3, 0.01, 200))
    bout = compare_pair(compared(a=[close], b=[loose]), "a", "b").bouts["s0"]
    assert bout.result == -1
    assert bout.improvement.value > 0.7
    assert bout.survival.high < 0.0


def test_a_flown_difference_decides() -> None:
    comparison = compare(
        {"aside": [BiasedADRC(0.03)], "honest": [BiasedADRC(0.0)], "falling": [ZeroThrust()]}, ["calm", "hover"], 20
    )
    assert compare_pair(comparison, "honest", "aside").won(1) == ["calm", "hover"]
    first, second, last = leaderboard(comparison)
    assert (first.policy, second.policy, last.policy) == ("honest", "aside", "falling")
    assert (first.wins, second.wins, last.wins) == (4, 2, 0)
    assert (first.losses, second.losses, last.losses) == (0, 2, 4)
    assert last.penalised_rmse == (1000.0, 1000.0, 1000.0)
    assert last.worst_survival.value == 0.0
    assert leaderboard_table([first, second, last]).row_count == 3


def test_every_scenario_weighs_the_same_in_the_leaderboard() -> None:
    flights = [
        synthetic_results(np.full(50, 0.1)),
        synthetic_results(np.full(50, 0.3)),
        synthetic_results(np.full(50, 0.2), np.arange(50) < 25),
    ]
    (only,) = leaderboard(compared(a=flights))
    assert only.penalised_rmse.value == pytest.approx((100.0 + 300.0 + 600.0) / 3)
    assert only.survival.value == pytest.approx(250.0 / 3)
    assert only.worst == "s2"
    (whole,) = leaderboard(compared(a=flights[:2]))
    assert whole.survival.low < whole.survival.value == whole.survival.high == 100.0


def test_learners_are_judged_over_their_training_seeds() -> None:
    """One good seed of five does not make a winner; five do."""
    random = np.random.default_rng(3)
    other = synthetic_results(random.normal(0.1, 0.01, 200))
    spread = synthetic_results(np.array([[0.04], [0.13], [0.09], [0.11], [0.12]]) + random.normal(0.0, 0.01, (5, 200)))
    steady = synthetic_results(random.normal(0.09, 0.01, (5, 200)))
    assert compare_pair(compared(a=[spread], b=[other]), "a", "b").bouts["s0"].result == 0
    assert compare_pair(compared(a=[steady], b=[other]), "a", "b").bouts["s0"].result == 1


def test_the_compare_command_says_it_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options: Any = ["--scenarios", "calm", "steady", "--episodes", "10", "--store", str(tmp_path)]
    main(["compare", "adrc-paper", "mine=adrc-matched", *options])
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith(
        "mine beats adrc-paper in 1 of 2 scenarios (steady), loses in none and is not distinguishable in 1 (calm); over"
        " all, its penalised RMSE is lower by"
    )
    assert "Holm" in printed
