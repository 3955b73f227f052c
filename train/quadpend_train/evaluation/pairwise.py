"""Pairwise comparison: which of two policies is better in each scenario, by how much, and how certain that is.

The first policy wins a scenario if it survives significantly more of its episodes. If the survival does not differ
significantly, the policy with the significantly smaller RMSE in the episodes that both survived wins. Otherwise neither
wins. Both quantities are tested in every scenario on the same episodes (`p_proportion` and `p_value`), and all tests of
one family are corrected together by Holm's method: the probability that at least one win or loss of the family is false
is at most 5 %, if the level of each single test is correct. The family of `compare_pair` is one pair, that of
`compare_all_pairs` and of the leaderboard is all pairs, so the latter report slightly fewer wins.

Few episodes cannot give a win by RMSE, however different the policies are: `episodes_needed` is the fewest that can.

The penalised RMSE (a fall counts as 1 m) is reported but does not decide who wins: falls that are rarer than about 3/n
may not be among n episodes, and then neither the mean nor its interval accounts for them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.statistics import (
    CONFIDENCE,
    Interval,
    holm,
    mean,
    p_proportion,
    p_value,
    paired_proportion,
    probability_of_improvement,
)
from quadpend_train.evaluation.table import Values, cells, names

_MIN_COMMON_SURVIVALS = 10  # fewest common survived episodes for which the RMSE is tested
_MAX_LISTED = 5  # largest number of scenarios that a sentence names


class ScenarioResult(NamedTuple):
    """Two policies in one scenario; differences are the first policy's value minus the second's.

    The p-values are corrected for multiple tests, the intervals are not. So a scenario without a winner may have an
    interval that excludes zero.

    Attributes:
        winner: 1 if the first policy wins, −1 if the second wins, 0 if they are not distinguishable.
        survival: Difference of the survival, percentage points.
        rmse: Difference of the RMSE in the episodes that both survived, mm; nan if there are none.
        penalised_rmse: Difference of the penalised RMSE, mm. Its interval does not account for falls rarer than about
            3/n.
        p_survival: p-value of equal survival, corrected by Holm's method.
        p_rmse: p-value of equal `rmse`, corrected; 1 if there are fewer than 10 episodes that both survived.
        improvement: Probability that the first policy has the smaller penalised RMSE in an episode.
    """

    winner: int
    survival: Interval
    rmse: Interval
    penalised_rmse: Interval
    p_survival: float
    p_rmse: float
    improvement: Interval


@dataclass(frozen=True)
class PairwiseComparison:
    """Two policies in all scenarios.

    Attributes:
        first: Name of the first policy.
        second: Name of the second policy.
        results: Result of each scenario, by the scenario's name.
        rmse_differences: First policy's penalised RMSE minus the second's in each scenario, mm, shape (s, n) each.
        episodes_needed: Fewest episodes of a scenario that can give a win by RMSE, see `episodes_needed`.
    """

    first: str
    second: str
    results: dict[str, ScenarioResult]
    rmse_differences: dict[str, Floats]
    episodes_needed: int

    @property
    def won(self) -> list[str]:
        """Scenarios that the first policy wins."""
        return [name for name, result in self.results.items() if result.winner > 0]

    @property
    def lost(self) -> list[str]:
        """Scenarios that the second policy wins."""
        return [name for name, result in self.results.items() if result.winner < 0]

    @property
    def undecided(self) -> list[str]:
        """Scenarios in which the policies are not distinguishable."""
        return [name for name, result in self.results.items() if not result.winner]

    def sentence(self) -> str:
        """Return one sentence: who wins which scenarios, and by how much; the policy with more wins is the subject."""
        won, lost, undecided = self.won, self.lost, self.undecided
        subject, other, sign = self.first, self.second, 1.0
        if len(lost) > len(won):
            won, lost, subject, other, sign = lost, won, other, subject, -1.0
        parts = []
        if won:
            scenarios = "scenarios" if len(self.results) > 1 else "scenario"
            parts.append(f"beats {other} in {len(won)} of {len(self.results)} {scenarios}{_listed(won)}")
            parts.append(f"loses in {len(lost) or 'none'}{_listed(lost)}")
        if undecided:
            whom = "" if won else f" from {other}"
            parts.append(f"is not distinguishable{whom} in {len(undecided)}{_listed(undecided)}")
        episodes, few = next(iter(self.rmse_differences.values())).shape[1], ""
        if undecided and episodes < self.episodes_needed:
            are = "1 episode is" if episodes == 1 else f"{episodes} episodes are"
            few = f"; {are} too few to show a difference, use at least {self.episodes_needed}"
        *before, last = parts
        joined = f"{', '.join(before)} and {last}" if before else last
        return f"{subject} {joined}; overall, its penalised RMSE is {self._overall_difference(sign)}{few}."

    def _overall_difference(self, sign: float) -> str:
        """Return the mean difference of the penalised RMSE over all scenarios, which have equal weights, as text.

        The mean over the won scenarios alone would be biased, because they were selected by the difference.
        `sign` is 1 for the difference of the first policy from the second, −1 for the opposite.
        """
        difference = mean(sign * np.mean(list(self.rmse_differences.values()), axis=0))
        lower = difference.value <= 0.0
        value, low, high = difference.negated() if lower else difference
        better = np.mean([result.improvement.value for result in self.results.values()])
        return (
            f"{'lower' if lower else 'higher'} by {_number(value, high)} mm"
            f"{' on average' if len(self.results) > 1 else ''},"
            f" 95 % interval {_number(low, high)} to {_number(high, high)};"
            f" probability of improvement {better if sign > 0.0 else 1.0 - better:.2f}"
        )


def _listed(names: Sequence[str]) -> str:
    """Return the names in brackets, or nothing if there are too many for a sentence."""
    return f" ({', '.join(names)})" if 0 < len(names) <= _MAX_LISTED else ""


def _number(value: float, largest: float) -> str:
    """Return a number with the decimals that are appropriate for the largest number beside it."""
    return f"{value:.{0 if largest >= 20.0 else 1 if largest >= 1.0 else 2}f}"


def compare_pair(table: pd.DataFrame, first: str, second: str) -> PairwiseComparison:
    """Compare two policies of a table of results in its scenarios; the tests of this pair are corrected together."""
    return _compare_pairs(table, [(first, second)])[first, second]


def compare_all_pairs(table: pd.DataFrame) -> dict[tuple[str, str], PairwiseComparison]:
    """Compare all pairs of the policies of a table of results; the tests of all pairs are corrected together."""
    return _compare_pairs(table, list(itertools.combinations(names(table, "policy"), 2)))


@lru_cache(maxsize=64)
def episodes_needed(tests: int, seeds: int = 1) -> int:
    """Return the fewest episodes in which the RMSE of two policies can differ significantly.

    It is the smallest number, at least 10, for which the smallest possible p-value, that of a difference that is the
    same in all episodes, is below 5 % after Holm's correction.
    """
    numbers = itertools.count(_MIN_COMMON_SURVIVALS)
    return next(n for n in numbers if tests * p_value(np.ones((seeds, n))) < 1.0 - CONFIDENCE)


def _compare_pairs(table: pd.DataFrame, pairs: Sequence[tuple[str, str]]) -> dict[tuple[str, str], PairwiseComparison]:
    found, scenarios = cells(table), names(table, "scenario")
    both = {(pair, name): (found[name, pair[0]], found[name, pair[1]]) for pair in pairs for name in scenarios}
    p_values = [p for values in both.values() for p in _p_values(*values)]
    corrected = iter(holm(p_values))
    results = {key: _scenario_result(*values, next(corrected), next(corrected)) for key, values in both.items()}
    out = {}
    for pair in pairs:
        differences = {name: 1000.0 * _penalised_rmse_difference(*both[pair, name]) for name in scenarios}
        needed = episodes_needed(len(p_values), max(map(len, differences.values())))
        out[pair] = PairwiseComparison(*pair, {name: results[pair, name] for name in scenarios}, differences, needed)
    return out


def _p_values(first: Values, second: Values) -> tuple[float, float]:
    """p-values of equal survival and of equal RMSE, not corrected."""
    rmse = _rmse_difference(first, second)
    enough = np.sum(~np.isnan(rmse).all(axis=0)) >= _MIN_COMMON_SURVIVALS
    return p_proportion(first["survived"], second["survived"]), p_value(rmse) if enough else 1.0


def _rmse_difference(first: Values, second: Values) -> Floats:
    """Difference of the RMSE in the episodes that both survived, m; nan in the others; shape (s, n)."""
    return np.asarray(np.where(first["survived"] & second["survived"], first["rmse"] - second["rmse"], np.nan))


def _penalised_rmse_difference(first: Values, second: Values) -> Floats:
    """Difference of the penalised RMSE, m, shape (s, n)."""
    return np.asarray(first["penalised_rmse"] - second["penalised_rmse"])


def _scenario_result(first: Values, second: Values, p_survival: float, p_rmse: float) -> ScenarioResult:
    survival = paired_proportion(first["survived"], second["survived"])
    rmse = mean(_rmse_difference(first, second))
    if p_survival < 1.0 - CONFIDENCE:
        winner = np.sign(survival.value)
    else:
        winner = -np.sign(rmse.value) if p_rmse < 1.0 - CONFIDENCE else 0.0
    return ScenarioResult(
        int(winner),
        survival.scaled(100.0),
        rmse.scaled(1000.0),
        mean(_penalised_rmse_difference(first, second)).scaled(1000.0),
        p_survival,
        p_rmse,
        probability_of_improvement(first["penalised_rmse"], second["penalised_rmse"]),
    )
