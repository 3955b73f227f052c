"""Two policies against each other: who wins where, by how much, and how sure that is.

A scenario is won by who survives more of its episodes; if that cannot be told apart, by who has the smaller RMSE in
those that both survived; if that cannot either, by nobody. Both are tested in every scenario (`p_proportion` and
`p_value`, over the same episodes), and all tests of a family are corrected together by Holm's method: the chance that
even one victory or defeat in it is not real is at most 5 %, as far as each test's own chance is what it says. The
family of `duel` is one pair, that of `duels` and of the leaderboard all pairs, so that these claim a little less.

The penalised RMSE (a fall counts as 1 m) says how much harm is done, but decides nothing: falls that are rarer than
about 3/n may not be among n episodes at all, and then neither the mean nor its interval knows of them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.statistics import (
    CONFIDENCE,
    Interval,
    holm,
    improvement,
    improvement_unpaired,
    mean,
    p_proportion,
    p_value,
    paired_proportion,
    wilcoxon,
)

_FEWEST = 10  # episodes that both survived, from which a claim about their RMSE is made


class ScenarioResult(NamedTuple):
    """One scenario of a duel; differences are the first policy's value minus the second's.

    Intervals are of the one scenario and not corrected, p-values are: a scenario without a winner may have an interval
    without zero.

    Attributes:
        result: 1 if the first wins, −1 if the second does, 0 if they cannot be told apart.
        survival: difference, %.
        rmse: difference in the episodes that both survived, mm; nan if there are none.
        penalised_rmse: difference, mm; its interval knows of no falls rarer than about 3/n.
        p_survival: of no difference in survival, corrected by Holm's method.
        p_rmse: of no difference in `rmse`, corrected; 1 if fewer than 10 episodes were survived by both.
        p_wilcoxon: of Wilcoxon's signed-rank test on the penalised RMSE, for whoever wants it; not corrected.
        improvement: probability that the first has the smaller penalised RMSE in an episode.
        improvement_unpaired: the same over all pairs of episodes, as rliable has it.
    """

    result: int
    survival: Interval
    rmse: Interval
    penalised_rmse: Interval
    p_survival: float
    p_rmse: float
    p_wilcoxon: float
    improvement: Interval
    improvement_unpaired: float


@dataclass(frozen=True)
class PairwiseComparison:
    """Two policies in all scenarios.

    Attributes:
        first: its name.
        second: its name.
        bouts: by scenario.
        advantage: by scenario, how far the first's penalised RMSE is below the second's, mm, shape (s, n) each.
    """

    first: str
    second: str
    bouts: dict[str, ScenarioResult]
    advantage: dict[str, Floats]

    def won(self, result: int) -> list[str]:
        """The scenarios that ended with this `Bout.result`."""
        return [name for name, bout in self.bouts.items() if bout.result == result]

    def sentence(self) -> str:
        """Who wins where, by how much, and how sure that is, told of whoever wins more often."""
        won, lost, drawn = (self.won(result) for result in (1, -1, 0))
        if len(lost) > len(won):
            return self.turned().sentence()
        told = []
        if won:
            told.append(f"beats {self.second} in {len(won)} of {_scenarios(len(self.bouts))}{_listed(won)}")
            told.append(f"loses in {len(lost) or 'none'}{_listed(lost)}")
        if drawn:
            whom = "" if won else f" from {self.second}"
            told.append(f"is not distinguishable{whom} in {len(drawn)}{_listed(drawn)}")
        return f"{self.first} {_joined(told)}; over all, its penalised RMSE is {self._amount()}."

    def turned(self) -> "PairwiseComparison":
        """The same, told of the second policy."""
        bouts = {
            name: bout._replace(
                result=-bout.result,
                survival=_minus(bout.survival),
                rmse=_minus(bout.rmse),
                penalised_rmse=_minus(bout.penalised_rmse),
                improvement=Interval(*(1.0 - x for x in np.take(bout.improvement, [0, 2, 1]))),
                improvement_unpaired=1.0 - bout.improvement_unpaired,
            )
            for name, bout in self.bouts.items()
        }
        return PairwiseComparison(
            self.second, self.first, bouts, {name: -value for name, value in self.advantage.items()}
        )

    def _amount(self) -> str:
        """How far the first's penalised RMSE is from the second's over all scenarios, which weigh the same.

        Over those won alone it would be too large: they were chosen because of it.
        """
        lower = mean(np.mean(list(self.advantage.values()), axis=0))
        value, low, high = lower if lower.value >= 0.0 else _minus(lower)
        chance = np.mean([bout.improvement.value for bout in self.bouts.values()])
        return (
            f"{'lower' if lower.value >= 0.0 else 'higher'} by {_number(value, high)} mm"
            f"{' on average' if len(self.bouts) > 1 else ''},"
            f" 95 % interval {_number(low, high)} to {_number(high, high)};"
            f" probability of improvement {chance:.2f}"
        )


def _minus(interval: Interval) -> Interval:
    return Interval(-interval.value, -interval.high, -interval.low)


def _scenarios(count: int) -> str:
    return f"{count} scenario{'s' if count > 1 else ''}"


def _listed(names: Sequence[str]) -> str:
    """A few names; many are left to the table."""
    return f" ({', '.join(names)})" if 0 < len(names) <= 5 else ""


def _joined(parts: Sequence[str]) -> str:
    *before, last = parts
    return f"{', '.join(before)} and {last}" if before else last


def _number(value: float, largest: float) -> str:
    """A number with as many digits as are worth reading of the largest that stands beside it."""
    return f"{value:.{0 if largest >= 20.0 else 1 if largest >= 1.0 else 2}f}"


def compare_pair(comparison: Comparison, first: str, second: str) -> PairwiseComparison:
    """The duel of two of a comparison's policies in its scenarios, its tests corrected for their number."""
    return _fought(comparison, [(first, second)])[first, second]


def compare_all_pairs(comparison: Comparison) -> dict[tuple[str, str], PairwiseComparison]:
    """The duels of all pairs of a comparison's policies, all their tests together corrected for their number."""
    return _fought(comparison, list(itertools.combinations(comparison.policies, 2)))


def _fought(comparison: Comparison, pairs: Sequence[tuple[str, str]]) -> dict[tuple[str, str], PairwiseComparison]:
    flown = {
        (pair, name): (comparison.flights[name, pair[0]], comparison.flights[name, pair[1]])
        for pair in pairs
        for name in comparison.scenarios
    }
    corrected = iter(holm([p for both in flown.values() for p in _p_values(*both)]))
    bouts = {fight: _bout(*both, next(corrected), next(corrected)) for fight, both in flown.items()}
    return {
        pair: PairwiseComparison(
            *pair,
            {name: bouts[pair, name] for name in comparison.scenarios},
            {name: -1000.0 * _penalised(*flown[pair, name]) for name in comparison.scenarios},
        )
        for pair in pairs
    }


def _p_values(flights: EpisodeResults, other: EpisodeResults) -> tuple[float, float]:
    """Of no difference in survival and none in RMSE, not corrected."""
    rmse = _rmse(flights, other)
    enough = np.sum(~np.isnan(rmse).all(axis=0)) >= _FEWEST
    return p_proportion(flights.survived, other.survived), p_value(rmse) if enough else 1.0


def _rmse(flights: EpisodeResults, other: EpisodeResults) -> Floats:
    """Difference of the RMSE (m) in the episodes that both survived, nan in the others, shape (s, n)."""
    return np.asarray(np.where(flights.survived & other.survived, flights.rmse - other.rmse, np.nan))


def _penalised(flights: EpisodeResults, other: EpisodeResults) -> Floats:
    """Difference of the penalised RMSE (m), shape (s, n)."""
    return flights.penalised_rmse - other.penalised_rmse


def _bout(flights: EpisodeResults, other: EpisodeResults, p_survival: float, p_rmse: float) -> ScenarioResult:
    survival, rmse = paired_proportion(flights.survived, other.survived), mean(_rmse(flights, other))
    if p_survival < 1.0 - CONFIDENCE:
        result = np.sign(survival.value)
    else:
        result = -np.sign(rmse.value) if p_rmse < 1.0 - CONFIDENCE else 0.0
    mine, its = flights.penalised_rmse, other.penalised_rmse
    return ScenarioResult(
        int(result),
        survival.scaled(100.0),
        rmse.scaled(1000.0),
        mean(_penalised(flights, other)).scaled(1000.0),
        p_survival,
        p_rmse,
        wilcoxon(_penalised(flights, other)),
        improvement(mine, its),
        improvement_unpaired(mine, its),
    )
