"""Tables of a comparison for the terminal and in Markdown, sentences, and error curves."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.episodes import FALL_ERROR
from quadpend_train.evaluation.formatting import format_interval, format_number, markdown_table
from quadpend_train.evaluation.metrics import METRICS
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.evaluation.ranking import LEAST, LOSS, gentle, too_few
from quadpend_train.reports import figures

METRIC_COLUMNS = [name for name in METRICS if name != "return"]  # in the tables
MANY_EPISODES = 50  # from this number on, most intervals cover close to 95 %, see docs/accuracy.md
_POINTS = 100  # of an error curve
_SMALLEST = 0.05  # mm, lower end of the error axis

Rows = list[Sequence[str]]  # cells of the headings, and then of each row


def metric_rows(comparison: Comparison) -> Rows:
    """Return all metrics of all policies with their 95 % intervals."""
    units = {name: METRICS[name].unit and f" ({METRICS[name].unit})" for name in METRIC_COLUMNS}
    rows: Rows = [["scenario", "policy", *(name.replace("_", " ") + unit for name, unit in units.items())]]
    for cell, summary in comparison.summaries.items():
        texts = {name: format_interval(summary[name]) for name in METRIC_COLUMNS}
        rows.append([*cell, *(texts | {"falls": comparison.falls[cell]}).values()])
    return rows


def with_margins(rows: Rows, comparison: Comparison) -> Rows:
    """Return `metric_rows` with the margins of the linear loops, where there are any."""
    if not comparison.margins:
        return rows
    margins = [comparison.margins.get(cell) for cell in comparison.summaries]
    texts = [(f"{1e3 * m.delay:.1f}", f"{np.rad2deg(m.phase):.0f}") if m else ("–", "–") for m in margins]
    headings = ("delay margin (ms)", "phase margin (°)")
    return [[*row, *more] for row, more in zip(rows, [headings, *texts], strict=True)]


def without(rows: Rows, columns: Sequence[str]) -> Rows:
    """Return rows without the columns whose headings begin with one of the names."""
    kept = [i for i, heading in enumerate(rows[0]) if not heading.startswith(tuple(columns))]
    return [[row[i] for i in kept] for row in rows]


def ranking_rows(comparison: Comparison) -> Rows:
    """Return the ranking; the policies without a rank follow, see `quadpend_train.evaluation.ranking`."""
    reference = (
        "linear reference" if comparison.references.keys() >= {*gentle(list(comparison.scenarios))} else "best policy's"
    )
    headings = ("rank", "policy", "survival (%)", "survival bound (%)", f"error (multiple of the {reference})")
    rows: Rows = [(*headings, "falls", "effort")]
    for row in comparison.ranking:
        bound = f"{format_number(row.least)} {row.group}"
        cells = format_interval(row.survival), bound, format_interval(row.multiple), str(row.falls), f"{row.effort:.2f}"
        rows.append([str(row.rank) if row.has_rank else "–", row.policy, *cells])
    return rows


def ranking_note(comparison: Comparison) -> str:
    """Return what a rank means, or that there are too few episodes to rank."""
    return (
        too_few(comparison.table)
        or f"A rank needs a survival of at least {LEAST:.0%} in every group of scenarios with 95 % confidence (bound:"
        f" that of the worst group). A policy stands above another only if it survives at most {LOSS:.0%} less with"
        " 95 % confidence; then the lower error decides, which is not tested. Policies without such an order share a"
        " rank. Levels are those of each policy and pair."
    )


def terminal_table(title: str, rows: Rows) -> Table:
    """Return rows as a table for the terminal, with a line between the scenarios."""
    table = Table(title=Text(title))
    headings, *body = rows
    for heading in headings:
        table.add_column(Text(heading), overflow="fold")
    for row, following in zip(body, [*body[1:], [""]], strict=True):
        table.add_row(*map(Text, row), end_section=headings[0] == "scenario" and row[0] != following[0])
    return table


def markdown(comparison: Comparison) -> str:
    """Return a Markdown page: the table of all metrics, a sentence for each policy, and the ranking."""
    lines = "\n".join(f"- {sentence}" for sentence in sentences(comparison))
    parts = [markdown_rows(metric_rows(comparison)), episodes_note(comparison), lines]
    if len(comparison.policies) > 1:
        parts += [markdown_rows(ranking_rows(comparison)), ranking_note(comparison)]
    return "\n\n".join(part for part in parts if part) + "\n"


def markdown_rows(rows: Rows) -> str:
    """Return rows as a Markdown table."""
    headings, *body = rows
    return markdown_table(headings, body)


def episodes_note(comparison: Comparison) -> str:
    """Return that the intervals are from few episodes; empty if there are enough."""
    few = f"The 95 % intervals are from few episodes, which seldom contain a rare fall: use at least {MANY_EPISODES}."
    return few if comparison.table.attrs["episodes"] < MANY_EPISODES else ""


def sentences(comparison: Comparison) -> list[str]:
    """Return one sentence for each policy but the first: in which scenarios it beats the first, and by how much."""
    first, *others = comparison.policies
    return [compare_pair(comparison.table, policy, first).sentence() for policy in others]


def draw_errors(axis: Any, comparison: Comparison, scenario: str) -> None:
    """Draw the tracking error over time: median and 80 % band over all episodes; `FALL_ERROR` after a fall."""
    length, period = comparison.scenarios[scenario].steps, comparison.scenarios[scenario].simulation.period
    interval, lowest = max(length // _POINTS, 1), np.inf
    for i, policy in enumerate(comparison.policies):
        every = comparison.errors[scenario, policy][..., interval - 1 :: interval]
        error = 1000.0 * np.fmin(np.nan_to_num(every.reshape(-1, every.shape[-1]), nan=FALL_ERROR), FALL_ERROR)
        low, middle, high = np.quantile(error, [0.1, 0.5, 0.9], axis=0)
        times = period * interval * np.arange(1, error.shape[-1] + 1)
        figures.draw_curve(axis, i, times, low, middle, high)
        lowest = min(lowest, low.min())
    figures.set_log_scale(axis, max(lowest, _SMALLEST), 1000.0 * FALL_ERROR)
    axis.grid(alpha=0.25)
    axis.set(xlim=(0.0, period * length), xlabel="time (s)", ylabel="tracking error (mm)")
