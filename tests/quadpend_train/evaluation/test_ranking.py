"""The flight benchmark starts on the reference and ranks by survival, then by multiples of a reference error."""

import numpy as np
import pytest

from quadpend_train.evaluation import ranking as ranking_module
from quadpend_train.evaluation.formatting import format_interval
from quadpend_train.evaluation.metrics import summary_table
from quadpend_train.evaluation.ranking import groups, multiple, ordered_sets, ranking
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports.tables import metric_rows, ranking_note, ranking_rows
from tests.helpers.policies import synthetic_comparison, synthetic_results

RANDOM = np.random.default_rng(0)


def draw(size: float) -> np.ndarray:
    return size * RANDOM.uniform(0.5, 1.5, 1000)


def test_survival_ranks_first_and_then_the_multiple_of_the_reference() -> None:
    """A policy that falls often is last however small its error; one that falls once in thousands is not."""
    once, often = np.arange(1000) != 7, np.arange(1000) % 25 != 0
    found = synthetic_comparison(
        steady=[synthetic_results(draw(0.02)), synthetic_results(draw(0.08))],
        precise=[synthetic_results(draw(0.01), once), synthetic_results(draw(0.04))],
        reckless=[synthetic_results(draw(0.001), often), synthetic_results(draw(0.001))],
    )
    rows = ranking(found.table, {"s0": 0.01, "s1": 0.04})
    assert [row.policy for row in rows] == ["precise", "steady", "reckless"]
    assert [row.has_rank for row in rows] == [True, True, False]
    for row, value in zip(rows, (1.04, 2.08, 0.045), strict=True):  # the root mean square of uniform numbers
        assert row.multiple.value == pytest.approx(value, rel=0.2)
        assert row.multiple.low < value < row.multiple.high or row.policy == "reckless"
    assert (rows[2].group, rows[2].falls) == ("gentle", 40)
    assert 97.0 < rows[2].least < 98.0
    assert ranking(found.table)[0].multiple.value == pytest.approx(1.0)  # relative to the best safe policy
    ranked = ranking_rows(found)
    assert ranked[0][4] == "error (multiple of the best policy's)"
    assert [row[0] for row in ranked[1:]] == ["1", "2", "–"]


@pytest.mark.parametrize(
    ("episodes", "falls"), [(5, 1), (5, 5), (20, 3), (200, 1), (267, 0), (268, 1), (400, 8), (2000, 60)]
)
def test_a_policy_that_falls_more_is_not_above_one_that_falls_less_for_its_error(episodes: int, falls: int) -> None:
    """Also where few episodes show no significant difference: none has a rank then, and survival orders them."""
    precise = synthetic_results(np.full(episodes, 0.001), np.arange(episodes) >= falls)
    found = synthetic_comparison(precise=[precise], steady=[synthetic_results(np.full(episodes, 0.1))])
    rows = ranking(found.table)
    assert [row.policy for row in rows] == (["steady", "precise"] if falls else ["precise", "steady"])
    assert rows[0].has_rank == (episodes >= 268)
    assert not rows[1].has_rank or falls == 1
    assert ("Not enough episodes to rank" in ranking_note(found)) == (episodes < 268)


def test_each_group_of_events_counts_by_itself_and_errors_count_in_gentle_scenarios_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Falls in 3 % of the episodes of one group are no more than 0.3 % of all, but cost the rank."""
    monkeypatch.setattr(ranking_module, "SETS", {"events-a": ("s1",), "events-b": ("s2",), "others": ("s0", "s1")})
    gentle, event = synthetic_results(np.full(4000, 0.01)), synthetic_results(np.full(4000, 5.0))
    falls = synthetic_results(np.full(4000, 0.01), np.arange(4000) >= 120)
    found = synthetic_comparison(
        safe=[gentle, event, event], falling=[gentle, falls, event], worse=[synthetic_results(np.full(4000, 0.02))] * 3
    )
    assert groups(["s0", "s1 · crazyflie", "s2"]) == {
        "gentle": ["s0"],
        "events-a": ["s1 · crazyflie"],
        "events-b": ["s2"],
    }
    rows = ranking(found.table, {"s0": 0.01})
    assert [(row.policy, row.has_rank) for row in rows] == [("safe", True), ("worse", True), ("falling", False)]
    assert [row.multiple.value for row in rows] == pytest.approx([1.0, 2.0, 1.0])
    assert rows[2].group == "events-a"


def test_pairs_without_an_order_share_a_rank_and_are_listed_by_survival() -> None:
    """Two policies fall in 4 of 460 episodes each, but not in the same ones: 0.87 % may be lost between them."""
    number = np.arange(460)
    found = synthetic_comparison(
        a=[synthetic_results(np.full(460, 0.01), number < 456)],
        b=[synthetic_results(np.full(460, 0.02), number >= 4)],
        c=[synthetic_results(np.full(460, 0.03))],
        d=[synthetic_results(np.full(460, 0.04))],
    )
    rows = ranking(found.table)
    assert [(row.policy, row.rank) for row in rows] == [("c", 1), ("d", 2), ("a", 3), ("b", 3)]
    assert [row[0] for row in ranking_rows(found)[1:]] == ["1", "2", "3", "3"]


def test_policies_that_stand_above_each_other_in_a_circle_share_their_place() -> None:
    above = {
        ("a", "b"),
        ("b", "c"),
        ("c", "a"),
        *((name, "last") for name in "abc"),
        *(("first", name) for name in "abc"),
    }
    sets = ordered_sets(["last", "c", "b", "a", "first"], lambda *pair: pair in above | {("first", "last")})
    assert sets == [["first"], ["c", "b", "a"], ["last"]]
    assert ordered_sets(["a", "b"], lambda *pair: False) == [["a", "b"]]
    assert ordered_sets([], lambda *pair: False) == []


def test_who_always_falls_has_no_error_and_no_rank_and_comes_last() -> None:
    """A policy without survivors in a scenario has no error."""
    falls, good, weak = (
        synthetic_results(np.full(300, 0.02), survived) for survived in (False, True, np.arange(300) < 150)
    )
    found = synthetic_comparison(bad=[falls, falls], half=[falls, good], steady=[good, good], weak=[weak, weak])
    _, *ranked = ranking_rows(found)
    assert [row[1] for row in ranked] == ["steady", "weak", "half", "bad"]
    assert [row[0] for row in ranked] == ["1", "–", "–", "–"]
    assert [row[4] for row in ranked[2:]] == ["–", "–"]
    assert [row[5] for row in ranked] == ["0", "300", "300", "600"]
    counts = ["falls", *(f"{n} ({n} tilt of the pole)" if n else "0" for n in (300, 300, 0, 150, 300, 0, 0, 150))]
    assert [row[3] for row in metric_rows(found)] == counts
    assert summary_table(found.summaries).query("metric == 'falls'")["value"].sum() == 1200
    assert format_interval(Interval(20.0, np.nan, np.nan)) == "20.0 [–, –]"
    assert not any(row.has_rank for row in ranking(synthetic_comparison(a=[falls], b=[falls]).table))


def test_all_training_seeds_of_a_learner_count_against_a_controller() -> None:
    seeds = synthetic_results(np.full((5, 400), 0.01), np.arange(2000).reshape(5, 400) % 1999 != 0)
    found = synthetic_comparison(learner=[seeds], controller=[synthetic_results(np.full(400, 0.02))])
    assert [(row.policy, row.rank, row.falls) for row in ranking(found.table)] == [
        ("learner", 1, 2),
        ("controller", 2, 0),
    ]
    uneven = synthetic_results(np.full((5, 400), 0.01), np.arange(2000).reshape(5, 400) >= 30)  # all of the first seed
    assert not ranking(synthetic_comparison(learner=[uneven]).table)[0].has_rank


def test_the_interval_of_a_multiple_covers_it_and_a_scenario_without_survivors_has_none() -> None:
    truth, covered = np.sqrt(1.0 + 1.0 / 12.0), 0
    for _ in range(100):
        _, low, high = multiple([draw(1.0)[np.newaxis], draw(3.0)[np.newaxis]], [1.0, 3.0])
        covered += low < truth < high
    assert covered > 85
    assert np.isnan(multiple([np.full((1, 5), np.nan), np.ones((1, 5))], [1.0, 1.0]).value)
