"""The ranking of the flight benchmark: survival first, and then the error as a multiple of a reference.

The policy with the highest survival is compared with every other one in the same episodes of all scenarios
(`p_proportion`, corrected by Holm's method). The policies whose survival is not significantly lower, if they have
survivors in every scenario, are ranked by

    (1)  exp( mean over scenarios s of  ½ log(mean of e² over survived episodes) − log r_s )

with the RMSE e of the scored steps of an episode and the reference r_s. The others follow, ordered by their survival.
The interval of (1) is that of its linearisation in the means of e².
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from quadpend_gym.core.arrays import Floats
from quadpend_train.evaluation.statistics import CONFIDENCE, Interval, holm, mean, p_proportion, proportion
from quadpend_train.evaluation.table import Values, cells


class RankingRow(NamedTuple):
    """One policy in the ranking."""

    policy: str
    has_rank: bool  # its survival is not significantly lower than the highest, and it has survivors in every scenario
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
    best = max(survived, key=lambda name: float(survived[name].mean()))
    others = [name for name in survived if name != best]
    p_values = dict(zip(others, holm([p_proportion(survived[name], survived[best]) for name in others]), strict=True))
    safe = {name for name in survived if p_values.get(name, 1.0) >= 1.0 - CONFIDENCE}
    errors = {name: [survivors(values) for values in found.values()] for name, found in by_policy.items()}
    smallest = np.fmin.reduce([[_size(error) for error in errors[name]] for name in safe])
    found = zip(by_policy[best], smallest, strict=True)
    limits = [(references or {}).get(scenario, size) for scenario, size in found]
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
    return sorted(rows, key=lambda row: (not row.has_rank, row.multiple.value if row.has_rank else -row.survival.value))


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
