"""The ranking of policies: survival first, and then the error as a multiple of a reference.

A policy is safe if it falls no more often than the one that falls least, or if it survives at most `MARGIN` less: the
lower end of the 95 % interval of the difference, in the same episodes of all scenarios, is above −`MARGIN`. So an error
never makes up for falls, and few episodes, which can show no difference, make no policy safe that falls more often.
Safe policies with survivors in every scenario are ranked by

    (1)  exp( mean over scenarios s of  ½ log(mean of e² over survived episodes) − log r_s )

with the RMSE e of the scored steps of an episode and the reference r_s. The others follow, ordered by their survival.
The interval of (1) is that of its linearisation in the means of e².
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.metrics import Values, cells
from quadpend_train.evaluation.statistics import Interval, mean, paired_proportion, proportion

MARGIN = 0.005  # of survival


class RankingRow(NamedTuple):
    """One policy in the ranking."""

    policy: str
    has_rank: bool  # it is safe and has survivors in every scenario
    survival: Interval  # %, of all episodes
    falls: int  # of all training seeds
    worst_survival: Interval  # % in the scenario where it is smallest; ignores the selection of this scenario
    worst_scenario: str
    multiple: Interval  # (1); nan if the policy falls in all episodes of a scenario
    effort: float  # mean over all episodes


def ranking(table: pd.DataFrame, references: Mapping[str, float] | None = None) -> list[RankingRow]:
    """Return the rows of all policies, the best first.

    `references` are those of the scenarios, m; that of a scenario without one is the smallest error of the safe
    policies.
    """
    by_policy: dict[str, dict[str, Values]] = {}
    for (scenario, policy), values in cells(table).items():
        by_policy.setdefault(policy, {})[scenario] = values
    survived = {name: np.concatenate([v["survived"] for v in found.values()], 1) for name, found in by_policy.items()}
    best = max(survived.values(), key=np.mean)
    differences = {name: paired_proportion(each, best) for name, each in survived.items()}
    safe = {name for name, found in differences.items() if found.value >= 0.0 or found.low > -MARGIN}
    errors = {name: [survivors(values) for values in found.values()] for name, found in by_policy.items()}
    smallest = np.fmin.reduce([[_size(error) for error in errors[name]] for name in safe])
    limits = [(references or {}).get(name, size) for name, size in zip(by_policy[min(safe)], smallest, strict=True)]
    rows = []
    for name, results in by_policy.items():
        worst = min(results, key=lambda scenario: float(results[scenario]["survived"].mean()))
        error = multiple(errors[name], limits)
        rows.append(
            RankingRow(
                name,
                name in safe and not np.isnan(error.value),
                proportion(survived[name]).scaled(100.0),
                int(np.sum(~survived[name])),
                proportion(results[worst]["survived"]).scaled(100.0),
                worst,
                error,
                float(np.mean([values["effort"].mean() for values in results.values()])),
            )
        )

    def place(row: RankingRow) -> tuple[bool, float, float]:
        error = row.multiple.value
        return not row.has_rank, 0.0 if row.has_rank else -row.survival.value, np.inf if np.isnan(error) else error

    return sorted(rows, key=place)


def survivors(values: Values) -> Floats:
    """Return the RMSE of each episode, m, nan for falls."""
    return np.asarray(np.where(values["survived"], values["rmse"], np.nan))


def _size(error: Floats) -> float:
    """Return the root mean square, nan if nothing is left."""
    return float(np.sqrt(np.nanmean(error**2))) if not np.isnan(error).all() else np.nan


def multiple(errors: Sequence[Floats], references: Sequence[float]) -> Interval:
    """Return (1) for the RMSE of each scenario, m, shape (s, n), nan for falls, and the references, m."""
    squares = [error**2 / _size(error) ** 2 for error in errors]  # of mean 1
    value = float(np.exp(np.mean(np.log([_size(error) for error in errors]) - np.log(references))))
    influence = [np.where(np.isnan(x), 0.0, 0.5 * (x - 1.0) / (1.0 - np.isnan(x).mean())) for x in squares]
    if np.isnan(value):
        return Interval(np.nan, np.nan, np.nan)
    _, low, high = mean(np.mean(influence, axis=0))
    return Interval(value, value * float(np.exp(low)), value * float(np.exp(high)))
