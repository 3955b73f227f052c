"""The table of results: one row for each episode, and the metrics that are computed from its columns.

The columns `KEYS` name an episode, and those of `COLUMNS` hold its values in SI units, see
`quadpend_train.evaluation.episodes.EpisodeResults`. The attribute `attrs` of the table holds the provenance.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quadpend_gym.envs.outcome import CAUSES
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.statistics import Interval, mean, proportion

Cell = tuple[str, str]  # names of a scenario and of a policy
Values = dict[str, Any]  # arrays of shape (training seeds, episodes) by the name of the column
KEYS = ("scenario", "policy", "training_seed", "episode")
COLUMNS = (
    *("survived", "cause", "steps", "rmse", "penalised_rmse", "settled_rmse", "largest_tilt", "effort", "action_rate"),
    "return",
)


class Metric(NamedTuple):
    """An estimate over the episodes of one policy in one scenario."""

    column: str  # of its values
    unit: str = ""
    factor: float = 1.0  # from the SI units of the table to `unit`
    estimate: Callable[[Any], Interval] = mean  # of values of shape (s, n)


def _failures(successes: Any) -> Interval:
    """Return a count, which has no interval."""
    return Interval(float(np.sum(~successes)), np.nan, np.nan)


METRICS = {
    "survival": Metric("survived", "%", 100.0, proportion),
    "falls": Metric("survived", estimate=_failures),
    "penalised_rmse": Metric("penalised_rmse", "mm", 1000.0),
    "rmse_of_survivors": Metric("rmse", "mm", 1000.0),
    "settled_rmse": Metric("settled_rmse", "mm", 1000.0),
    "largest_tilt": Metric("largest_tilt", "°", 180.0 / np.pi),
    "effort": Metric("effort"),
    "action_rate": Metric("action_rate", "1/s"),
    "return": Metric("return"),
}


def values_of(results: EpisodeResults) -> Values:
    """Return the columns of one policy in one scenario as arrays of shape (s, n); causes of falls are texts."""
    values = {name: getattr(results, "episode_return" if name == "return" else name) for name in COLUMNS}
    return values | {"cause": np.take(CAUSES, results.cause)}


def rows(scenario: str, policy: str, results: EpisodeResults) -> pd.DataFrame:
    """Return the rows of one policy in one scenario, by training seed and episode."""
    seed, episode = (index.ravel() for index in np.indices(results.survived.shape))
    values = {name: array.ravel() for name, array in values_of(results).items()}
    return pd.DataFrame({"scenario": scenario, "policy": policy, "training_seed": seed, "episode": episode, **values})


def cells(table: pd.DataFrame) -> dict[Cell, Values]:
    """Return the columns of each policy in each scenario as arrays of shape (s, n), in the order of the table."""
    found = {}
    for cell, part in table.groupby(["scenario", "policy"], sort=False):
        shape = part["training_seed"].nunique(), -1
        found[cell] = {name: part[name].to_numpy().reshape(shape) for name in COLUMNS}
    return found


def summarise(values: Values) -> dict[str, Interval]:
    """Return every metric of `METRICS` in its unit, with its 95 % interval.

    ``rmse_of_survivors`` and ``settled_rmse`` are means over the survived episodes. No metric is negative.
    """
    survivors = np.where(values["survived"], values["rmse"], np.nan)
    return {
        name: metric.estimate(survivors if name == "rmse_of_survivors" else values[metric.column])
        .clipped(0.0)
        .scaled(metric.factor)
        for name, metric in METRICS.items()
    }


def falls(values: Values) -> str:
    """Return the number of falls with their causes, the most frequent first, such as ``3 (2 ground, 1 distance)``."""
    causes = Counter(values["cause"][~values["survived"]].tolist())
    parts = ", ".join(f"{number} {cause}" for cause, number in causes.most_common())
    return f"{causes.total()} ({parts})" if causes else "0"


def summary_table(summaries: dict[Cell, dict[str, Interval]]) -> pd.DataFrame:
    """Return all metrics as a table with a row for each scenario, policy and metric."""
    columns = ["scenario", "policy", "metric", "value", "low", "high", "unit"]
    lines = [(*cell, name, *found[name], METRICS[name].unit) for cell, found in summaries.items() for name in METRICS]
    return pd.DataFrame(lines, columns=columns)
