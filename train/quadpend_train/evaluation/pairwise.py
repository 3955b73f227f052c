"""Pairwise comparison: which of two policies is better in each scenario, by how much, and how certain that is.

The first policy wins a scenario if it survives significantly more of its episodes. If the survival does not differ
significantly, the policy with the significantly smaller RMSE in the episodes that both survived wins. Otherwise neither
wins. Both quantities are tested in every scenario on the same episodes (`p_proportion` and `p_value`), and all tests of
one family, that is of all pairs that are compared at once, are corrected together by Holm's method: the probability
that at least one win or loss of the family is false is at most 5 %, if the level of each single test is correct.

The penalised RMSE (a fall counts as 1 m) is reported but does not decide who wins: falls that are rarer than about 3/n
may not be among n episodes, and then neither the mean nor its interval accounts for them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.metrics import Values, cells
from quadpend_train.evaluation.statistics import CONFIDENCE, holm, mean, p_proportion, p_value

_MIN_COMMON_SURVIVALS = 10  # fewest common survived episodes for which the RMSE is tested
_MAX_LISTED = 5  # largest number of scenarios that a sentence names


class PairwiseComparison(NamedTuple):
    """Two policies, by name, in all scenarios."""

    first: str
    second: str
    winners: dict[str, int]  # by scenario: 1 if the first policy wins, −1 if the second wins, 0 if neither
    differences: dict[str, Floats]  # first policy's penalised RMSE minus the second's, mm, shape (s, n) each

    def where(self, winner: int) -> list[str]:
        """Return the scenarios that the first policy wins (1), that the second wins (−1), or that neither wins (0)."""
        return [name for name, found in self.winners.items() if found == winner]

    def sentence(self) -> str:
        """Return one sentence: who wins which scenarios, and by how much; the policy with more wins is the subject.

        The mean difference is over all scenarios. Over the won scenarios alone it would be biased, because they were
        selected by the difference.
        """
        sign = -1 if len(self.where(-1)) > len(self.where(1)) else 1
        subject, other = (self.first, self.second)[::sign]
        won, lost, undecided = (self.where(sign * winner) for winner in (1, -1, 0))
        parts, total = [], len(self.winners)
        if won:
            scenarios = "scenarios" if total > 1 else "scenario"
            parts.append(f"beats {other} in {len(won)} of {total} {scenarios}{_listed(won)}")
            parts.append(f"loses in {len(lost) or 'none'}{_listed(lost)}")
        if undecided:
            whom = "" if won else f" from {other}"
            parts.append(f"is not distinguishable{whom} in {len(undecided)}{_listed(undecided)}")
        joined = " and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]]))
        difference = sign * np.mean(list(self.differences.values()), axis=0)
        lower = mean(difference).value <= 0.0
        value, low, high = mean(-difference if lower else difference)
        decimals = 0 if high >= 20.0 else 1 if high >= 1.0 else 2
        return (
            f"{subject} {joined}; overall, its penalised RMSE is {'lower' if lower else 'higher'} by"
            f" {value:.{decimals}f} mm{' on average' if total > 1 else ''}, 95 % interval {low:.{decimals}f} to"
            f" {high:.{decimals}f}."
        )


def _listed(names: Sequence[str]) -> str:
    """Return the names in brackets, or nothing if there are too many for a sentence."""
    return f" ({', '.join(names)})" if 0 < len(names) <= _MAX_LISTED else ""


def compare_pair(table: pd.DataFrame, first: str, second: str) -> PairwiseComparison:
    """Compare two policies of a table of results in its scenarios; the tests of this pair are corrected together."""
    return compare_pairs(table, [(first, second)])[first, second]


def compare_pairs(table: pd.DataFrame, pairs: Sequence[tuple[str, str]]) -> dict[tuple[str, str], PairwiseComparison]:
    """Compare pairs of policies of a table of results; the tests of all these pairs are corrected together."""
    found, out = cells(table), {pair: PairwiseComparison(*pair, {}, {}) for pair in pairs}
    scenarios = dict.fromkeys(table["scenario"])
    both = {(pair, name): (found[name, pair[0]], found[name, pair[1]]) for pair in pairs for name in scenarios}
    corrected = iter(holm([p for values in both.values() for p in _p_values(*values)]))
    for (pair, name), (first, second) in both.items():
        out[pair].winners[name] = _winner(first, second, next(corrected), next(corrected))
        out[pair].differences[name] = 1000.0 * (first["penalised_rmse"] - second["penalised_rmse"])
    return out


def _p_values(first: Values, second: Values) -> tuple[float, float]:
    """p-values of equal survival and of equal RMSE, not corrected."""
    rmse = _rmse_difference(first, second)
    enough = np.sum(~np.isnan(rmse).all(axis=0)) >= _MIN_COMMON_SURVIVALS
    return p_proportion(first["survived"], second["survived"]), p_value(rmse) if enough else 1.0


def _rmse_difference(first: Values, second: Values) -> Floats:
    """Difference of the RMSE in the episodes that both survived, m; nan in the others; shape (s, n)."""
    return np.asarray(np.where(first["survived"] & second["survived"], first["rmse"] - second["rmse"], np.nan))


def _winner(first: Values, second: Values, p_survival: float, p_rmse: float) -> int:
    """Return the sign of a win, see `PairwiseComparison.winners`, from corrected p-values."""
    if p_survival < 1.0 - CONFIDENCE:
        return int(np.sign(np.mean(first["survived"]) - np.mean(second["survived"])))
    return -int(np.sign(mean(_rmse_difference(first, second)).value)) if p_rmse < 1.0 - CONFIDENCE else 0
