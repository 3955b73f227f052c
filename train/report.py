"""A comparison for the eye: a table for the terminal, the same in Markdown, and a plot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from train.duel import Duel, Standing, leaderboard
from train.evaluate import MEASURES, Comparison
from train.statistics import Interval

# Okabe and Ito's colours, distinguishable by the colour-blind.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
COLUMNS = ("survival", "penalised_rmse", "rmse", "settled_rmse", "largest_tilt", "effort")  # of the tables
_SMALLEST = 0.02  # mm, lower end of the plot


def _cell(interval: Interval) -> str:
    value, low, high = interval
    if np.isnan(value):
        return "–"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _heading(name: str) -> str:
    unit = MEASURES[name].unit
    return f"{name.replace('_', ' ')}{f' ({unit})' if unit else ''}"


def _cells(comparison: Comparison) -> list[list[str]]:
    return [
        [scenario, policy, *(_cell(comparison.summaries[scenario, policy][name]) for name in COLUMNS)]
        for scenario in comparison.scenarios
        for policy in comparison.policies
    ]


def table(comparison: Comparison) -> Table:
    """Every cell with its 95 % interval, for the terminal."""
    title = f"{comparison.episodes} episodes each, seeds from {comparison.seed}, 95 % intervals"
    out = _table(title, ["scenario", "policy", *map(_heading, COLUMNS)])
    for row in _cells(comparison):
        out.add_row(*row, end_section=row[1] == comparison.policies[-1])
    return out


def _table(title: str, headings: Sequence[str]) -> Table:
    out = Table(title=title)
    for heading in headings:
        out.add_column(heading, overflow="fold")
    return out


STANDINGS = ("rank", "policy", "penalised rmse (mm)", "survival (%)", "worst survival (%)", "wins", "losses")


def _standings(standings: Sequence[Standing]) -> list[list[str]]:
    return [
        [
            str(rank),
            standing.policy,
            _cell(standing.penalised_rmse),
            _cell(standing.survival),
            f"{_cell(standing.worst_survival)} {standing.worst}",
            str(standing.wins),
            str(standing.losses),
        ]
        for rank, standing in enumerate(standings, 1)
    ]


def leaderboard_table(standings: Sequence[Standing]) -> Table:
    """The leaderboard, for the terminal."""
    out = _table("All scenarios together, each weighing the same", STANDINGS)
    for row in _standings(standings):
        out.add_row(*row)
    return out


BOUTS = ("scenario", "winner", "penalised rmse (mm)", "p", "survival (points)", "p", "improvement")


def duel_table(duel: Duel) -> Table:
    """The differences of a duel, scenario by scenario, for the terminal."""
    out = _table(f"{duel.first} minus {duel.second}, 95 % intervals, p corrected by Holm's method", BOUTS)
    for name, bout in duel.bouts.items():
        winner = {1: duel.first, -1: duel.second, 0: "–"}[bout.result]
        rmse, survival = _cell(bout.penalised_rmse), _cell(bout.survival)
        out.add_row(
            name, winner, rmse, f"{bout.p_rmse:.2g}", survival, f"{bout.p_survival:.2g}", _cell(bout.improvement)
        )
    return out


def _markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in [headings, ["---"] * len(headings), *rows])


def markdown(comparison: Comparison) -> str:
    """The table in Markdown, under it who is better and by how much, and the leaderboard."""
    text = _markdown_table(["scenario", "policy", *map(_heading, COLUMNS)], _cells(comparison))
    if sentences := verdicts(comparison):
        text += "\n\n" + "\n".join(f"- {sentence}" for sentence in sentences)
    if len(comparison.policies) > 1 and len(comparison.scenarios) > 1:
        text += "\n\n" + _markdown_table(STANDINGS, _standings(leaderboard(comparison)))
    return f"{text}\n"


def verdicts(comparison: Comparison) -> list[str]:
    """One sentence for each scenario and policy: is it better than the first one, and by how much."""
    first = comparison.policies[0]
    return [
        _verdict(comparison, scenario, policy, first)
        for scenario in comparison.scenarios
        for policy in comparison.policies[1:]
    ]


def _verdict(comparison: Comparison, scenario: str, policy: str, first: str) -> str:
    by = comparison.minus_first[scenario, policy]
    closer = _judged(by["penalised_rmse"], "mm of penalised RMSE", MEASURES["penalised_rmse"].better, "closer", "worse")
    longer = _judged(by["survival"], "points", MEASURES["survival"].better, "more often", "less often")
    return f"In {scenario}, {policy} tracks {closer} than {first}, and survives {longer}."


def _judged(difference: Interval, unit: str, sign: int, better: str, worse: str) -> str:
    value, low, high = difference
    if low <= 0.0 <= high:
        return f"neither {better} nor {worse} (difference {value:.1f}, 95 % interval {low:.1f} to {high:.1f} {unit})"
    word = better if value * sign > 0 else worse
    least, most = sorted([abs(low), abs(high)])
    return f"{word} by {abs(value):.1f} {unit} (95 % interval {least:.1f} to {most:.1f})"


def plot(comparison: Comparison, path: Path) -> None:
    """Tracking error over time in every scenario: median and 80 % band of the episodes still flying."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(comparison.scenarios), 2 if len(comparison.scenarios) <= 4 else 4)
    rows = -(-len(comparison.scenarios) // columns)
    figure = Figure(figsize=(0.6 + 4.6 * columns, 0.6 + 2.7 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, scenario in zip(axes, comparison.scenarios, strict=False):
        for i, policy in enumerate(comparison.policies):
            error = comparison.flights[scenario, policy].error * 1000.0
            error = error.reshape(-1, error.shape[-1])
            flown = ~np.isnan(error).all(axis=0)
            low, middle, high = np.nanquantile(error[:, flown], [0.1, 0.5, 0.9], axis=0)
            time = 0.01 * (1 + np.flatnonzero(flown))
            colour = COLOURS[i % len(COLOURS)]
            axis.plot(time, middle, color=colour, linewidth=1.5, label=policy)
            axis.fill_between(time, low, high, color=colour, alpha=0.2, linewidth=0)
        axis.set(title=scenario, yscale="log", ylim=(_SMALLEST, None))
        axis.grid(alpha=0.3)
    for axis in axes[len(comparison.scenarios) :]:
        axis.set_axis_off()
    figure.supxlabel("time (s)", fontsize=10)
    figure.supylabel("tracking error (mm)", fontsize=10)
    axes[0].legend(frameon=False)
    figure.suptitle(f"Median and 80 % band of the episodes still flying, of {comparison.episodes}", fontsize=10)
    figure.savefig(path, dpi=150)
