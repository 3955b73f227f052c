"""Pairwise comparisons find known differences, and equal policies have no winner."""

from itertools import combinations

import numpy as np
import pandas as pd
import pytest

from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.pairwise import compare_pair, compare_pairs
from quadpend_train.reports.tables import episodes_note
from tests.helpers.policies import synthetic_comparison, synthetic_results
from tests.helpers.scenarios import shorten_scenarios


def compared(**policies: list[EpisodeResults]) -> pd.DataFrame:
    """The table of synthetic results."""
    return synthetic_comparison(**policies).table


def test_a_known_difference_is_significant_and_in_its_interval() -> None:
    random = np.random.default_rng(0)
    base = [random.normal(0.1, 0.03, 200) for _ in range(6)]
    better = [values - random.normal(0.01, 0.01, 200) for values in base[:5]] + [
        base[5] + random.normal(0.0, 0.01, 200)
    ]
    pair = compare_pair(
        compared(a=[synthetic_results(x) for x in better], b=[synthetic_results(x) for x in base]), "a", "b"
    )
    assert pair.where(1) == ["s0", "s1", "s2", "s3", "s4"]
    assert pair.where(0) == ["s5"]
    sentence = pair.sentence()
    assert sentence.startswith(
        "a beats b in 5 of 6 scenarios (s0, s1, s2, s3, s4), loses in none and is not distinguishable in 1 (s5);"
        " overall, its penalised RMSE is lower by "
    )


def test_equal_policies_have_no_winner(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten_scenarios(monkeypatch, 3.0)
    same = compare({"one": "adrc-paper", "two": "adrc-paper"}, ["calm", "windy"], 10)
    assert (
        compare_pair(same.table, "one", "two")
        .sentence()
        .startswith("one is not distinguishable from two in 2 (calm, windy); overall")
    )


def test_the_rmse_is_tested_only_with_enough_common_survivals() -> None:
    few, many = np.arange(200) < 9, np.arange(200) < 12
    for survived, winner in ((few, 0), (many, 1)):
        pair = compare_pair(
            compared(
                a=[synthetic_results(np.full(200, 0.1), survived)], b=[synthetic_results(np.full(200, 0.2), survived)]
            ),
            "a",
            "b",
        )
        assert pair.winners["s0"] == winner


def test_all_pairs_of_a_comparison_are_one_family_of_tests() -> None:
    """A pair alone wins at least as often."""
    random = np.random.default_rng(5)
    base = random.normal(0.1, 0.03, 200)
    results = {
        name: [synthetic_results(base + random.normal(0.0005 * i, 0.005, 200))] for i, name in enumerate("abcdef")
    }
    comparison = compared(**results)
    together = compare_pairs(comparison, [*combinations("abcdef", 2)])
    assert len(together) == 15
    for (first, second), pair in together.items():
        assert pair.winners["s0"] in (0, compare_pair(comparison, first, second).winners["s0"])
    decided = sum(len(pair.where(1)) + len(pair.where(-1)) for pair in together.values())
    assert 0 < decided < 15


def test_survival_comes_first() -> None:
    """A policy that tracks closely but falls loses to one that tracks worse and survives."""
    random = np.random.default_rng(2)
    close = synthetic_results(random.normal(0.02, 0.001, 200), random.random(200) < 0.8)
    loose = synthetic_results(random.normal(0.3, 0.01, 200))
    assert compare_pair(compared(a=[close], b=[loose]), "a", "b").winners["s0"] == -1


def test_too_few_episodes_are_said_in_words() -> None:
    for episodes in (49, 50):
        comparison = synthetic_comparison(one=[synthetic_results([0.1] * episodes)])
        assert ("use at least 50" in episodes_note(comparison)) == (episodes < 50)
