"""A comparison for the eye: a table for the terminal, the same in Markdown, and a plot."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table

from quadpend_baselines.gains import TUNED
from quadpend_gym.physics.parameters import CONTROL_PERIOD
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_train.evaluation.comparison import METRICS, Comparison
from quadpend_train.evaluation.episodes import FALL_ERROR
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.leaderboard import LeaderboardRow, leaderboard
from quadpend_train.evaluation.pairwise import PairwiseComparison, ScenarioResult, compare_pair
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures

COLUMNS = ("survival", "penalised_rmse", "rmse_of_survivors", "settled_rmse", "largest_tilt", "effort")  # of the tables
_THINNED = 10  # every so many steps are drawn
_SMALLEST = 0.05  # mm, lower end of the plots


def _heading(name: str) -> str:
    unit = METRICS[name].unit
    return f"{name.replace('_', ' ')}{f' ({unit})' if unit else ''}"


def _cells(comparison: Comparison) -> list[list[str]]:
    return [
        [scenario, policy, *(format_interval(comparison.summaries[scenario, policy][name]) for name in COLUMNS)]
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


def _standings(standings: Sequence[LeaderboardRow]) -> list[list[str]]:
    return [
        [
            str(rank),
            standing.policy,
            format_interval(standing.penalised_rmse),
            format_interval(standing.survival),
            f"{format_interval(standing.worst_survival)} {standing.worst_scenario}",
            str(standing.wins),
            str(standing.losses),
        ]
        for rank, standing in enumerate(standings, 1)
    ]


def leaderboard_table(standings: Sequence[LeaderboardRow]) -> Table:
    """The leaderboard, for the terminal."""
    out = _table("All scenarios together, each weighing the same; wins and losses by Holm's method", STANDINGS)
    for row in _standings(standings):
        out.add_row(*row)
    return out


BOUTS = ("scenario", "winner", "survival (points)", "p", "rmse where both survive (mm)", "p", "penalised rmse (mm)")


def duel_table(fought: PairwiseComparison) -> Table:
    """The differences of a duel, scenario by scenario, and the probability of improvement, for the terminal."""
    title = f"{fought.first} minus {fought.second}, 95 % intervals, p corrected by Holm's method"
    out = _table(title, [*BOUTS, "improvement"])
    for name, bout in fought.results.items():
        winner = {1: fought.first, -1: fought.second, 0: "–"}[bout.winner]
        survival = [format_interval(bout.survival), f"{bout.p_survival:.2g}"]
        rmse = [format_interval(bout.rmse), f"{bout.p_rmse:.2g}"]
        out.add_row(
            name, winner, *survival, *rmse, format_interval(bout.penalised_rmse), format_interval(bout.improvement)
        )
    return out


def _markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in [headings, ["---"] * len(headings), *rows])


def table_markdown(comparison: Comparison) -> str:
    """The table in Markdown."""
    return _markdown_table(["scenario", "policy", *map(_heading, COLUMNS)], _cells(comparison))


def tuning_markdown(policies: Sequence[str]) -> str:
    """How the gains of those policies that were tuned were found, in Markdown."""
    rows = [[name, f"`{TUNED[name].command}`", format_number(TUNED[name].score)] for name in policies if name in TUNED]
    return _markdown_table(["controller", "found by", "score (mm)"], rows)


def matrix_markdown(comparison: Comparison) -> str:
    """Penalised RMSE in mm of every cell, each scenario's smallest in bold, and survival where it is not complete."""
    rows = []
    for scenario in comparison.scenarios:
        summaries = [comparison.summaries[scenario, policy] for policy in comparison.policies]
        least = min(summary["penalised_rmse"].value for summary in summaries)
        row = []
        for summary in summaries:
            rmse, survival = summary["penalised_rmse"].value, summary["survival"].value
            number = f"**{format_number(rmse)}**" if rmse == least else format_number(rmse)
            row.append(number if survival == 100.0 else f"{number} ({survival:.3g} %)")
        rows.append([scenario, *row])
    return _markdown_table(["scenario", *comparison.policies], rows)


def leaderboard_markdown(standings: Sequence[LeaderboardRow]) -> str:
    """The leaderboard in Markdown."""
    return _markdown_table(STANDINGS, _standings(standings))


def markdown(comparison: Comparison) -> str:
    """The table in Markdown, under it who is better and by how much, and the leaderboard."""
    text = table_markdown(comparison)
    if sentences := verdicts(comparison):
        text += "\n\n" + "\n".join(f"- {sentence}" for sentence in sentences)
    if len(comparison.policies) > 1 and len(comparison.scenarios) > 1:
        text += "\n\n" + leaderboard_markdown(leaderboard(comparison))
    return f"{text}\n"


def verdicts(comparison: Comparison) -> list[str]:
    """One sentence for each scenario and policy: does it beat the first one in their duel, and by how much."""
    first, *others = comparison.policies
    fought = [compare_pair(comparison, policy, first) for policy in others]
    return [_verdict(scenario, one, one.results[scenario]) for scenario in comparison.scenarios for one in fought]


def _verdict(scenario: str, fought: PairwiseComparison, bout: ScenarioResult) -> str:
    beats = f"{fought.first} beats {fought.second}"
    loses = f"{fought.first} loses to {fought.second}"
    neither = f"{fought.first} and {fought.second} cannot be told apart"
    return (
        f"In {scenario}, {[neither, beats, loses][bout.winner]}: RMSE where both survive {_judged(bout.rmse, 'mm')},"
        f" survival {_judged(bout.survival, 'points')}."
    )


def _judged(difference: Interval, unit: str) -> str:
    """How much higher or lower the first is, with the interval of that amount: "lower by 2.00 mm [-1.00, 5.00]"."""
    value = difference.value
    if np.isnan(value):
        return "unknown"
    amount = difference.negated() if value < 0.0 else difference
    word = "lower" if value < 0.0 else "higher" if value > 0.0 else "different"
    text, _, ends = format_interval(amount).partition(" ")
    return f"{word} by {text} {unit} {ends}"


def draw_errors(axis: Any, comparison: Comparison, scenario: str) -> None:
    """Tracking error over time: median and 80 % band of all episodes, in which the fallen stay at `FALL_ERROR`."""
    lowest = np.inf
    for i, policy in enumerate(comparison.policies):
        flown = comparison.results[scenario, policy].error[..., _THINNED - 1 :: _THINNED]
        error = 1000.0 * np.fmin(np.nan_to_num(flown.reshape(-1, flown.shape[-1]), nan=FALL_ERROR), FALL_ERROR)
        low, middle, high = np.quantile(error, [0.1, 0.5, 0.9], axis=0)
        figures.curve(axis, i, CONTROL_PERIOD * _THINNED * np.arange(1, error.shape[-1] + 1), low, middle, high)
        lowest = min(lowest, low.min())
    figures.logarithmic(axis, max(lowest, _SMALLEST), 1000.0 * FALL_ERROR)
    axis.grid(alpha=0.25)
    axis.set(xlim=(0.0, CONTROL_PERIOD * EPISODE_STEPS), xlabel="time (s)", ylabel="tracking error (mm)")


def plot(comparison: Comparison) -> Any:
    """The figure of the tracking errors in every scenario."""
    columns = min(len(comparison.scenarios), 2 if len(comparison.scenarios) <= 4 else 4)
    rows = -(-len(comparison.scenarios) // columns)
    figure = figures.blank(0.6 + 4.2 * columns, 0.6 + 2.7 * rows)
    axes = figures.grid(figure, rows, columns).ravel()
    for axis, scenario in zip(axes, comparison.scenarios, strict=False):
        draw_errors(axis, comparison, scenario)
        axis.set_title(scenario)
    for axis in axes[len(comparison.scenarios) :]:
        axis.set_axis_off()
    figures.legend(figure, comparison.policies)
    return figure
