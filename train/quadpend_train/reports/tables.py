"""Tables of a comparison for the terminal and in Markdown, sentences, and a figure of the error curves."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from quadpend_baselines.gains import TUNED
from quadpend_gym.wind import Rescaled
from quadpend_train.common.text import figure_text, markdown_text
from quadpend_train.evaluation.comparison import METRICS, Comparison
from quadpend_train.evaluation.episodes import FALL_ERROR
from quadpend_train.evaluation.formatting import format_interval, format_number, markdown_table
from quadpend_train.evaluation.leaderboard import LeaderboardRow, leaderboard
from quadpend_train.evaluation.pairwise import PairwiseComparison, ScenarioResult, compare_pair, episodes_needed
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures

# Metrics in the tables.
COLUMNS = ("survival", "penalised_rmse", "rmse_of_survivors", "settled_rmse", "largest_tilt", "effort")
LEADERBOARD_COLUMNS = ("rank", "policy", "penalised rmse (mm)", "survival (%)", "worst survival (%)", "wins", "losses")
PAIRWISE_COLUMNS = (
    "scenario",
    "winner",
    "survival (points)",
    "p",
    "rmse where both survive (mm)",
    "p",
    "penalised rmse (mm)",
    "improvement",
)
MANY_EPISODES = 50  # from this number on, most intervals cover close to 95 %, see docs/accuracy.md
_MANY_FALLS = 5  # with fewer, an interval of a mean covers less, see docs/accuracy.md
_MOST_NAMED = 5  # cells in a note
_POINTS = 100  # of an error curve
_SMALLEST = 0.05  # mm, lower end of the error axis


def comparison_table(comparison: Comparison) -> Table:
    """Return a table for the terminal with all metrics of all policies and their 95 % intervals."""
    title = f"{comparison.episodes} episodes each, seeds from {comparison.seed}, 95 % intervals"
    table = _table(title, ["scenario", "policy", *map(_heading, COLUMNS)])
    for cells in _comparison_cells(comparison):
        table.add_row(*map(Text, cells), end_section=cells[1] == comparison.policies[-1])
    return table


def leaderboard_table(standings: Sequence[LeaderboardRow], bound: LeaderboardRow | None = None) -> Table:
    """Return the leaderboard as a table for the terminal, below the row of `bound_row` if there is one."""
    title = "Means over all scenarios with equal weights; wins and losses by Holm's method"
    table = _table(title, LEADERBOARD_COLUMNS)
    for cells in _leaderboard_cells(standings, bound):
        table.add_row(*map(Text, cells))
    return table


def pairwise_table(pair: PairwiseComparison) -> Table:
    """Return a table for the terminal with the differences of two policies in each scenario."""
    title = f"{pair.first} minus {pair.second}, 95 % intervals, p corrected by Holm's method"
    table = _table(title, PAIRWISE_COLUMNS)
    for scenario, result in pair.results.items():
        cells = (
            scenario,
            {1: pair.first, -1: pair.second, 0: "–"}[result.winner],
            format_interval(result.survival),
            f"{result.p_survival:.2g}",
            format_interval(result.rmse),
            f"{result.p_rmse:.2g}",
            format_interval(result.penalised_rmse),
            format_interval(result.improvement),
        )
        table.add_row(*map(Text, cells))
    return table


def markdown(comparison: Comparison, standings: Sequence[LeaderboardRow] | None = None) -> str:
    """Return a Markdown page: the table of all metrics, a sentence for each policy and scenario, and the leaderboard.

    Args:
        comparison: Comparison to describe.
        standings: Leaderboard of the comparison; computed if None.
    """
    text = comparison_markdown(comparison)
    text += f"\n\n{episodes_note(comparison)}" if episodes_note(comparison) else ""
    if sentences := verdicts(comparison):
        text += "\n\n" + "\n".join(f"- {markdown_text(sentence)}" for sentence in sentences)
    if len(comparison.policies) > 1 and len(comparison.scenarios) > 1:
        text += "\n\n" + leaderboard_markdown(leaderboard(comparison) if standings is None else standings)
        text += f"\n\n{leaderboard_note(comparison)}" if leaderboard_note(comparison) else ""
    if note := vehicle_note(comparison):
        text += f"\n\n{note}"
    return f"{text}\n"


def notes(comparison: Comparison) -> list[str]:
    """Return the notes below the table of a comparison: about few episodes and about a scaled wind."""
    return [note for note in (episodes_note(comparison), vehicle_note(comparison)) if note]


def episodes_note(comparison: Comparison) -> str:
    """Return that the intervals are from few episodes, or which are from few falls; empty if there are none."""
    if comparison.episodes >= MANY_EPISODES:
        falls = {
            f"{policy} in {scenario}": np.sum(~results.survived)
            for (scenario, policy), results in comparison.results.items()
            if len(results.survived) == 1  # the interval of several training seeds is another one
        }
        return falls_note([cell for cell, count in falls.items() if 0 < count < _MANY_FALLS])
    few = f"{comparison.episodes} episode{'s' if comparison.episodes > 1 else ''}"
    return (
        f"The 95 % intervals are from {few}. They contain the true value in less than 95 % of all studies, because few"
        f" episodes seldom contain a rare fall. Use at least {MANY_EPISODES} episodes."
    )


def falls_note(cells: Sequence[str]) -> str:
    """Return that the intervals of some cells ("lqr in windy") are from few falls; empty without cells."""
    if not cells:
        return ""
    more = f" and {len(cells) - _MOST_NAMED} more" if len(cells) > _MOST_NAMED else ""
    return (
        f"Few falls (1 to {_MANY_FALLS - 1}): {', '.join(cells[:_MOST_NAMED])}{more}. There, the 95 % interval of the"
        " penalised RMSE contains the true value in less than 95 % of all studies: use more episodes."
    )


def leaderboard_note(comparison: Comparison) -> str:
    """Return that there are too few episodes for wins by RMSE on the leaderboard; empty if there are enough."""
    pairs = len(comparison.policies) * (len(comparison.policies) - 1) // 2
    tests = 2 * pairs * len(comparison.scenarios)
    needed = episodes_needed(tests, max(len(results.survived) for results in comparison.results.values()))
    if not pairs or comparison.episodes >= needed:
        return ""
    few = f"{comparison.episodes} episode{'s are' if comparison.episodes > 1 else ' is'}"
    return f"{few} too few for wins by RMSE with {tests} tests: use at least {needed} episodes."


def vehicle_note(comparison: Comparison) -> str:
    """Return by which factors forces and torques of the wind are scaled to the vehicle; empty if they are not."""
    scaled = [
        (model, scenario.simulation.parameters.hover_thrust)
        for scenario in comparison.scenarios.values()
        for model in scenario.wind.models
        if isinstance(model, Rescaled)
    ]
    if not scaled:
        return ""
    forces = dict.fromkeys(f"{model.scale:.3g} ({weight:.3g} N)" for model, weight in scaled)
    torques = dict.fromkeys(" / ".join(f"{factor:.3g}" for factor in model.torque_factors) for model, _ in scaled)
    return (
        f"Forces of the wind are scaled to the weight of the vehicle, by {', '.join(forces)}, and its torques about"
        f" x / y / z to the torque limits, by {', '.join(torques)}; wind velocities are not."
    )


def comparison_markdown(comparison: Comparison) -> str:
    """Return a Markdown table with all metrics of all policies and their 95 % intervals."""
    return markdown_table(["scenario", "policy", *map(_heading, COLUMNS)], _comparison_cells(comparison))


def leaderboard_markdown(standings: Sequence[LeaderboardRow], bound: LeaderboardRow | None = None) -> str:
    """Return the leaderboard as a Markdown table, below the row of `bound_row` if there is one."""
    return markdown_table(LEADERBOARD_COLUMNS, _leaderboard_cells(standings, bound))


def tuning_markdown(policies: Sequence[str]) -> str:
    """Return a Markdown table with the tuning command and the score of each policy whose gains were tuned."""
    rows = [[name, f"`{TUNED[name].command}`", format_number(TUNED[name].score)] for name in policies if name in TUNED]
    return markdown_table(["controller", "found by", "score (mm)"], rows)


def matrix_markdown(comparison: Comparison) -> str:
    """Return a Markdown table of the penalised RMSE in mm, with one line for each scenario.

    The smallest value of a scenario is bold. Survival follows in parentheses where it is below 100 %.
    """
    rows = []
    for scenario in comparison.scenarios:
        summaries = [comparison.summaries[scenario, policy] for policy in comparison.policies]
        smallest = min(summary["penalised_rmse"].value for summary in summaries)
        cells = []
        for summary in summaries:
            rmse, survival = summary["penalised_rmse"].value, summary["survival"].value
            number = f"**{format_number(rmse)}**" if rmse == smallest else format_number(rmse)
            cells.append(number if survival == 100.0 else f"{number} ({survival:.3g} %)")
        rows.append([scenario, *cells])
    return markdown_table(["scenario", *comparison.policies], rows)


def verdicts(comparison: Comparison) -> list[str]:
    """Return one sentence for each scenario and policy: whether it beats the first policy, and by how much."""
    first, *others = comparison.policies
    pairs = [compare_pair(comparison, policy, first) for policy in others]
    return [_verdict(scenario, pair, pair.results[scenario]) for scenario in comparison.scenarios for pair in pairs]


def plot(comparison: Comparison) -> Any:
    """Return a figure of the tracking errors over time in all scenarios."""
    columns = min(len(comparison.scenarios), 2 if len(comparison.scenarios) <= 4 else 4)
    rows = -(-len(comparison.scenarios) // columns)
    figure = figures.new_figure(0.6 + 4.2 * columns, 0.6 + 2.7 * rows)
    axes = figures.add_axes(figure, rows, columns).ravel()
    for axis, scenario in zip(axes, comparison.scenarios, strict=False):
        draw_errors(axis, comparison, scenario)
        axis.set_title(figure_text(scenario))
    for axis in axes[len(comparison.scenarios) :]:
        axis.set_axis_off()
    figures.add_legend(figure, comparison.policies)
    return figure


def draw_errors(axis: Any, comparison: Comparison, scenario: str) -> None:
    """Draw the tracking error over time: median and 80 % band over all episodes.

    An episode counts as `FALL_ERROR` after a fall.

    Args:
        axis: Matplotlib axes.
        comparison: Comparison to draw.
        scenario: Name of the scenario.
    """
    length, period = comparison.scenarios[scenario].steps, comparison.scenarios[scenario].simulation.period
    interval, lowest = max(length // _POINTS, 1), np.inf
    for i, policy in enumerate(comparison.policies):
        every = comparison.results[scenario, policy].error[..., interval - 1 :: interval]
        error = 1000.0 * np.fmin(np.nan_to_num(every.reshape(-1, every.shape[-1]), nan=FALL_ERROR), FALL_ERROR)
        low, middle, high = np.quantile(error, [0.1, 0.5, 0.9], axis=0)
        times = period * interval * np.arange(1, error.shape[-1] + 1)
        figures.draw_curve(axis, i, times, low, middle, high)
        lowest = min(lowest, low.min())
    figures.set_log_scale(axis, max(lowest, _SMALLEST), 1000.0 * FALL_ERROR)
    axis.grid(alpha=0.25)
    axis.set(xlim=(0.0, period * length), xlabel="time (s)", ylabel="tracking error (mm)")


def _heading(name: str) -> str:
    unit = METRICS[name].unit
    return f"{name.replace('_', ' ')}{f' ({unit})' if unit else ''}"


def _comparison_cells(comparison: Comparison) -> list[list[str]]:
    return [
        [scenario, policy, *(format_interval(comparison.summaries[scenario, policy][name]) for name in COLUMNS)]
        for scenario in comparison.scenarios
        for policy in comparison.policies
    ]


def _leaderboard_cells(standings: Sequence[LeaderboardRow], bound: LeaderboardRow | None) -> list[list[str]]:
    ranked = [("–", bound)] if bound else []
    ranked += [(str(rank), row) for rank, row in enumerate(standings, 1)]
    return [
        [
            rank,
            row.policy,
            format_interval(row.penalised_rmse),
            format_interval(row.survival),
            f"{format_interval(row.worst_survival)} {row.worst_scenario}",
            *("–" if count is None else str(count) for count in (row.wins, row.losses)),
        ]
        for rank, row in ranked
    ]


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(title=Text(title))
    for heading in headings:
        table.add_column(Text(heading), overflow="fold")
    return table


def _verdict(scenario: str, pair: PairwiseComparison, result: ScenarioResult) -> str:
    beats = f"{pair.first} beats {pair.second}"
    loses = f"{pair.first} loses to {pair.second}"
    neither = f"{pair.first} and {pair.second} show no significant difference"
    few = f"; {pair.too_few}" if result.winner == 0 and pair.too_few else ""
    return (
        f"In {scenario}, {[neither, beats, loses][result.winner]}: RMSE where both survive"
        f" {_describe(result.rmse, 'mm')}, survival {_describe(result.survival, 'points')}{few}."
    )


def _describe(difference: Interval, unit: str) -> str:
    """Return how much higher or lower the first policy's value is, such as "lower by 2.00 mm [-1.00, 5.00]"."""
    value = difference.value
    if np.isnan(value):
        return "unknown"
    word = "lower" if value < 0.0 else "higher" if value > 0.0 else "different"
    amount, _, ends = format_interval(difference.negated() if value < 0.0 else difference).partition(" ")
    return f"{word} by {amount} {unit} {ends}"
