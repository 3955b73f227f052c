"""Errors in multiples of the reference, and their figures, for `experiments.flight`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from experiments.lqg_front import PATH
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.metrics import cells
from quadpend_train.evaluation.ranking import multiple, survivors
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures

MARKERS = "os^vDP*X<>ph"


def errors_of(found: Comparison, policy: str) -> list[Any]:
    """Return the errors of a policy in each scenario, m, shape (s, n), nan for falls."""
    return [survivors(values) for (_, name), values in cells(found.table).items() if name == policy]


def cell_table(found: Comparison) -> pd.DataFrame:
    """Return survival (%), reference and error of the survivors (mm), and the multiple with its interval."""
    rows = []
    for policy in found.policies:
        for (scenario, limit), error in zip(found.references.items(), errors_of(found, policy), strict=True):
            share, ratio = 100.0 * np.mean(~np.isnan(error)), multiple([error], [limit])
            rows.append((scenario, policy, share, 1e3 * limit, 1e3 * limit * ratio.value, *ratio))
    columns = ["scenario", "policy", "survival", "reference", "error", "multiple", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def front_figure(here: pd.DataFrame, delays: Mapping[str, Interval]) -> Any:
    """Return the figure of the error in a breeze over the extra delay, with the front of LQG designs.

    Policies that fall too often without an extra delay are left out.
    """
    front = pd.read_csv(PATH)
    flown = front[front["extra_delay"] > 0.0]
    figure = figures.new_figure(7.5, 4.4)
    ((axis,),) = figures.add_axes(figure, 1, 1)
    grey = {"color": "#888888"}
    axis.plot(1e3 * front["delay_margin"], front["multiple"], ".:", **grey, label="LQG designs, linear model: margin")
    axis.plot(1e3 * flown["extra_delay"], flown["flown"], ".-", **grey, label="LQG designs, flown")
    for i, row in enumerate(here.itertuples()):
        x, *ends = delays[row.policy].scaled(1e3)
        if x == 0.0:
            continue
        bars = {
            "xerr": np.abs([[end - x] for end in ends]),
            "yerr": np.abs([[end - row.multiple] for end in (row.low, row.high)]),
        }
        axis.errorbar(x, row.multiple, **bars, fmt=MARKERS[i], color=figures.colour(i), label=row.policy)
    axis.set(xlabel="extra delay (ms)", ylabel="error (multiple of the linear reference)")
    axis.set(xlim=(-1.0, None), yscale="log", ylim=(0.9, None))
    return finish(figure, axis, axis.yaxis)


def scenario_figure(table: pd.DataFrame) -> Any:
    """Return the figure of the multiples in each scenario; symbols are empty where survival is below 99 %."""
    figure = figures.new_figure(7.5, 6.0)
    ((axis,),) = figures.add_axes(figure, 1, 1)
    for i, (name, part) in enumerate(table.groupby("policy", sort=False)):
        faces = [figures.colour(i) if share >= 99.0 else "white" for share in part["survival"]]
        style = {"marker": MARKERS[i], "edgecolors": figures.colour(i), "zorder": 3}
        axis.scatter(part["multiple"], range(len(part)), c=faces, **style)
        axis.scatter([], [], c=figures.colour(i), label=name, **style)
    axis.set_yticks(range(len(part)), part["scenario"].str.removeprefix("flight_"))
    axis.invert_yaxis()
    axis.set(xlabel="error (multiple of the reference)", xscale="log")
    return finish(figure, axis, axis.xaxis)


def finish(figure: Any, axis: Any, scale: Any) -> Any:
    """Add grid, ticks of a logarithmic scale, and legend."""
    figures.set_log_ticks(scale, (1.0, 2.0, 5.0))
    axis.grid(color="#dddddd", linewidth=0.5)
    figure.legend(loc="outside right center", frameon=False)
    return figure
