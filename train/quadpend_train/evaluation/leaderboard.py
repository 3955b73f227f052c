"""The leaderboard: all policies of a comparison in order of their mean penalised RMSE."""

from typing import NamedTuple

import numpy as np

from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.pairwise import compare_all_pairs
from quadpend_train.evaluation.statistics import Interval, mean, proportion


class LeaderboardRow(NamedTuple):
    """A policy's row of the leaderboard.

    Every scenario weighs the same. Episode k has the same start and reference in most scenarios, so its values are
    averaged over them before their mean's interval is made: what the scenarios have in common counts.

    Attributes:
        policy: its name.
        penalised_rmse: mean over the scenarios, mm; its interval knows of no falls rarer than about 3/n.
        survival: mean over the scenarios, %, with the ends of that interval or of Wilson's for all episodes together
            that lie farther out.
        worst_survival: share survived in the scenario where that is smallest, %; its interval does not count that the
            scenario was chosen for it.
        worst: that scenario.
        wins: scenarios won against every other policy, summed over them, see `duels`.
        losses: scenarios lost against them.
    """

    policy: str
    penalised_rmse: Interval
    survival: Interval
    worst_survival: Interval
    worst: str
    wins: int
    losses: int


def leaderboard(comparison: Comparison) -> list[LeaderboardRow]:
    """All policies, the smallest mean penalised RMSE first."""
    results = compare_all_pairs(comparison)

    def count(name: str, result: int) -> int:
        first = sum(len(fought.won(result)) for (a, _), fought in results.items() if a == name)
        return first + sum(len(fought.won(-result)) for (_, b), fought in results.items() if b == name)

    return sorted(
        (_standing(comparison, name, count(name, 1), count(name, -1)) for name in comparison.policies),
        key=lambda standing: standing.penalised_rmse.value,
    )


def _standing(comparison: Comparison, policy: str, wins: int, losses: int) -> LeaderboardRow:
    flights = {name: comparison.flights[name, policy] for name in comparison.scenarios}
    survived = {name: flown.survived for name, flown in flights.items()}
    worst = min(survived, key=lambda name: float(survived[name].mean()))
    survival = mean(np.mean(list(survived.values()), axis=0)).clipped(0.0, 1.0)
    pooled = proportion(np.stack(list(survived.values())).reshape(1, -1))
    return LeaderboardRow(
        policy,
        mean(np.mean([flown.penalised_rmse for flown in flights.values()], axis=0)).scaled(1000.0),
        survival.widened(pooled).scaled(100.0),
        proportion(survived[worst]).scaled(100.0),
        worst,
        wins,
        losses,
    )
