"""Two policies against each other: who wins where, by how much, and how sure that is.

A scenario is won by who survives more of its episodes; if that cannot be told apart, by who has the smaller penalised
RMSE (a fall counts as 1 m); if that cannot either, by nobody. Both are tested in every scenario (`statistics.p_value`,
over the same episodes), and all these tests together are corrected by Holm's method: the chance that even one of
the victories or defeats is not real is at most 5 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpend_gym.arrays import Floats
from train.evaluate import Comparison
from train.flights import Flights
from train.statistics import (
    CONFIDENCE,
    Interval,
    holm,
    improvement,
    improvement_unpaired,
    mean,
    p_value,
    paired_proportion,
    proportion,
    wilcoxon,
)


class Bout(NamedTuple):
    """One scenario of a duel; differences are the first policy's value minus the second's.

    Attributes:
        result: 1 if the first wins, −1 if the second does, 0 if they cannot be told apart.
        survival: difference, %.
        penalised_rmse: difference, mm.
        p_survival: of no difference in survival, corrected by Holm's method.
        p_rmse: of no difference in penalised RMSE, corrected.
        p_wilcoxon: of Wilcoxon's signed-rank test on the penalised RMSE, for whoever wants it; not corrected.
        improvement: probability that the first has the smaller penalised RMSE in an episode.
        improvement_unpaired: the same over all pairs of episodes, as rliable has it.
    """

    result: int
    survival: Interval
    penalised_rmse: Interval
    p_survival: float
    p_rmse: float
    p_wilcoxon: float
    improvement: Interval
    improvement_unpaired: float


@dataclass(frozen=True)
class Duel:
    """Two policies in all scenarios.

    Attributes:
        first: its name.
        second: its name.
        bouts: by scenario.
        advantage: by scenario, how far the first's penalised RMSE is below the second's, mm, shape (s, n) each.
    """

    first: str
    second: str
    bouts: dict[str, Bout]
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
            share = f"{len(won)} of {_scenarios(len(self.bouts))}"
            told.append(f"beats {self.second} in {share} (penalised RMSE {self._amount(won)})")
        if lost:
            told.append(f"loses in {len(lost)} ({_listed(lost)}{self._amount(lost)})")
        if drawn:
            whom = "" if won else f" from {self.second}"
            told.append(f"is not distinguishable{whom} in {len(drawn)}{_listed(drawn, ' (', ')')}")
        return f"{self.first} {_joined(told)}; over all, its penalised RMSE is {self._amount(list(self.bouts))}."

    def turned(self) -> "Duel":
        """The same, told of the second policy."""
        bouts = {
            name: bout._replace(
                result=-bout.result,
                survival=_minus(bout.survival),
                penalised_rmse=_minus(bout.penalised_rmse),
                improvement=Interval(*(1.0 - x for x in np.take(bout.improvement, [0, 2, 1]))),
                improvement_unpaired=1.0 - bout.improvement_unpaired,
            )
            for name, bout in self.bouts.items()
        }
        return Duel(self.second, self.first, bouts, {name: -value for name, value in self.advantage.items()})

    def _amount(self, names: Sequence[str]) -> str:
        """How far the first's penalised RMSE is from the second's in these scenarios, which weigh the same."""
        lower = mean(np.mean([self.advantage[name] for name in names], axis=0))
        value, low, high = lower if lower.value >= 0.0 else _minus(lower)
        chance = np.mean([self.bouts[name].improvement.value for name in names])
        return (
            f"{'lower' if lower.value >= 0.0 else 'higher'} by {_number(value)} mm"
            f"{' on average' if len(names) > 1 else ''}, 95 % interval {_number(low)} to {_number(high)};"
            f" probability of improvement {chance:.2f}"
        )


def _minus(interval: Interval) -> Interval:
    return Interval(-interval.value, -interval.high, -interval.low)


def _scenarios(count: int) -> str:
    return f"{count} scenario{'s' if count > 1 else ''}"


def _listed(names: Sequence[str], before: str = "", after: str = ": ") -> str:
    """A few names; many are left to the table."""
    return f"{before}{', '.join(names)}{after}" if len(names) <= 5 else ""


def _joined(parts: Sequence[str]) -> str:
    *before, last = parts
    return f"{', '.join(before)} and {last}" if before else last


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 20.0 else f"{value:.1f}" if abs(value) >= 1.0 else f"{value:.2f}"


def duel(comparison: Comparison, first: str, second: str) -> Duel:
    """The duel of two of a comparison's policies in its scenarios."""
    pairs = {name: (comparison.flights[name, first], comparison.flights[name, second]) for name in comparison.scenarios}
    tests = [p_value(difference) for pair in pairs.values() for difference in _tested(*pair)]
    corrected = iter(holm(tests))
    bouts = {name: _bout(*pair, next(corrected), next(corrected)) for name, pair in pairs.items()}
    advantage = {name: -1000.0 * _tested(*pair)[1] for name, pair in pairs.items()}
    return Duel(first, second, bouts, advantage)


def _tested(flights: Flights, other: Flights) -> tuple[Floats, Floats]:
    """What is tested in a scenario: differences of survival and of penalised RMSE (m), shape (s, n) each."""
    return flights.survived.astype(np.float64) - other.survived, flights.penalised_rmse - other.penalised_rmse


def _bout(flights: Flights, other: Flights, p_survival: float, p_rmse: float) -> Bout:
    survival, rmse = _tested(flights, other)
    if p_survival < 1.0 - CONFIDENCE:
        result = np.sign(survival.mean())
    else:
        result = -np.sign(rmse.mean()) if p_rmse < 1.0 - CONFIDENCE else 0.0
    mine, its = flights.penalised_rmse, other.penalised_rmse
    return Bout(
        int(result),
        paired_proportion(flights.survived, other.survived).scaled(100.0),
        mean(rmse).scaled(1000.0),
        p_survival,
        p_rmse,
        wilcoxon(rmse),
        improvement(mine, its),
        improvement_unpaired(mine, its),
    )


class Standing(NamedTuple):
    """A policy's row of the leaderboard.

    Every scenario weighs the same. Episode k has the same start and reference in most scenarios, so the bootstrap draws
    it in all of them at once: strata keep their sizes, and what they have in common counts.

    Attributes:
        policy: its name.
        penalised_rmse: mean over the scenarios, mm.
        survival: mean over the scenarios, %.
        worst_survival: share survived in the scenario where that is smallest, %.
        worst: that scenario.
        wins: scenarios won against every other policy in turn, see `Duel`.
        losses: scenarios lost against them.
    """

    policy: str
    penalised_rmse: Interval
    survival: Interval
    worst_survival: Interval
    worst: str
    wins: int
    losses: int


def leaderboard(comparison: Comparison) -> list[Standing]:
    """All policies, the smallest mean penalised RMSE first."""
    names = comparison.policies
    results = {(a, b): duel(comparison, a, b) for i, a in enumerate(names) for b in names[i + 1 :]}

    def count(name: str, result: int) -> int:
        first = sum(len(fought.won(result)) for (a, _), fought in results.items() if a == name)
        return first + sum(len(fought.won(-result)) for (_, b), fought in results.items() if b == name)

    return sorted(
        (_standing(comparison, name, count(name, 1), count(name, -1)) for name in names),
        key=lambda standing: standing.penalised_rmse.value,
    )


def _standing(comparison: Comparison, policy: str, wins: int, losses: int) -> Standing:
    flights = {name: comparison.flights[name, policy] for name in comparison.scenarios}
    survived = {name: flown.survived.astype(np.float64) for name, flown in flights.items()}
    worst = min(survived, key=lambda name: survived[name].mean())
    return Standing(
        policy,
        mean(np.mean([flown.penalised_rmse for flown in flights.values()], axis=0)).scaled(1000.0),
        mean(np.mean(list(survived.values()), axis=0)).scaled(100.0),
        proportion(flights[worst].survived).scaled(100.0),
        worst,
        wins,
        losses,
    )
