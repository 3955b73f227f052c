"""The leaderboard: all policies of a comparison, ordered by their mean penalised RMSE over the scenarios."""

from collections import Counter
from typing import NamedTuple

import numpy as np
import pandas as pd

from quadpend_train.evaluation.pairwise import compare_all_pairs
from quadpend_train.evaluation.statistics import Interval, mean, proportion
from quadpend_train.evaluation.table import Values, cells


class LeaderboardRow(NamedTuple):
    """One policy on the leaderboard.

    All scenarios have the same weight. Episode k has the same start and reference in most scenarios, so the values of
    different scenarios are not independent. Therefore each episode is averaged over the scenarios first, and the
    interval is that of the mean of these averages.
    """

    policy: str
    penalised_rmse: Interval  # mm; does not account for falls rarer than about 3/n
    survival: Interval  # %; also covers Wilson's interval of all episodes together
    worst_survival: Interval  # % in the scenario where it is smallest; ignores the selection of this scenario
    worst_scenario: str
    wins: int  # scenarios won, summed over all other policies, see `compare_all_pairs`
    losses: int

    @property
    def has_rank(self) -> bool:
        """Whether the policy survives at all."""
        return self.survival.value > 0.0


def leaderboard(table: pd.DataFrame) -> list[LeaderboardRow]:
    """Return the rows of all policies, ordered by the mean penalised RMSE, the smallest first; without rank last."""
    wins: Counter[tuple[str, int]] = Counter()  # by policy and sign: 1 for wins, −1 for losses
    for (first, second), pair in compare_all_pairs(table).items():
        for sign in (1, -1):
            wins += Counter({(first, sign): len(pair.where(sign)), (second, -sign): len(pair.where(sign))})
    by_policy: dict[str, dict[str, Values]] = {}
    for (scenario, policy), values in cells(table).items():
        by_policy.setdefault(policy, {})[scenario] = values
    lines = [standing(policy, results, wins[policy, 1], wins[policy, -1]) for policy, results in by_policy.items()]
    return sorted(lines, key=lambda row: (not row.has_rank, row.penalised_rmse.value))


def standing(policy: str, results: dict[str, Values], wins: int, losses: int) -> LeaderboardRow:
    """Return the row of a policy from its values in each scenario."""
    survived = {name: values["survived"] for name, values in results.items()}
    worst = min(survived, key=lambda name: float(survived[name].mean()))
    survival = mean(np.mean(list(survived.values()), axis=0)).clipped(0.0, 1.0)
    pooled = proportion(np.stack(list(survived.values())).reshape(1, -1))
    return LeaderboardRow(
        policy,
        mean(np.mean([values["penalised_rmse"] for values in results.values()], axis=0)).clipped(0.0).scaled(1000.0),
        survival.widened(pooled).scaled(100.0),
        proportion(survived[worst]).scaled(100.0),
        worst,
        wins,
        losses,
    )
