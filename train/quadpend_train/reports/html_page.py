"""The report of a comparison as one HTML page, which needs no network and no other files.

`templates/report.html` is its template. The page also contains all numbers as JSON, in the element with the id
``data``.
"""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from quadpend_train.common.files import to_json_data, write_text
from quadpend_train.evaluation.comparison import METRICS, Comparison
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.leaderboard import LeaderboardRow
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures, robustness_plots
from quadpend_train.reports.tables import COLUMNS, draw_errors, episodes_note, leaderboard_note
from quadpend_train.studies.robustness import Robustness, format_tolerated_range

_DASHES = ("", "5 3", "1.5 2.5", "6 2 1.5 2")  # of SVG lines, in the order of `figures.LINES`
_LIGHTEST, _DARKEST = 10.0, 1000.0  # penalised RMSE of the lightest and of the darkest cells, mm


class Section(NamedTuple):
    """An additional section of the page.

    Attributes:
        id: Id of the element.
        title: Heading.
        content: HTML, in which names must be escaped.
        style: HTML for the head of the page.
    """

    id: str
    title: str
    content: Markup
    style: Markup = Markup("")


def write(
    comparison: Comparison,
    standings: Sequence[LeaderboardRow],
    robustness: Robustness | None,
    path: Path,
    sections: Sequence[Section] = (),
    title: str = "Comparison of policies for a pendulum on a quadrotor",
    date: str | None = None,
) -> None:
    """Write the page. Pages of the same data differ only in the line with the date.

    Args:
        comparison: Comparison to report.
        standings: Leaderboard of the comparison.
        robustness: Robustness of the same policies in the same order, or None.
        path: HTML file.
        sections: Sections to insert after the pairwise comparisons.
        title: Title of the page.
        date: Date on the page; None is today in UTC.

    Raises:
        ValueError: If `robustness` has other policies than `comparison`.
    """
    if robustness and robustness.policies != comparison.policies:
        raise ValueError(
            f"robustness must be of {', '.join(comparison.policies)}, not {', '.join(robustness.policies)}"
        )
    first, *others = comparison.policies
    text = (
        environment()
        .get_template("report.html")
        .render(
            title=title,
            date=date or datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
            comparison=comparison,
            provenance=comparison.provenance(),
            policies=comparison.policies,
            styles=[style(i) for i in range(len(comparison.policies))],
            smallest_rmse={name: _smallest_rmse(comparison, name) for name in comparison.scenarios},
            standings=standings,
            note=leaderboard_note(comparison),
            episodes_note=episodes_note(comparison),
            pairs=[compare_pair(comparison, other, first) for other in others],
            metrics={name: METRICS[name] for name in COLUMNS},
            errors={name: _svg(_error_figure(comparison, name), f"error-{name}") for name in comparison.scenarios},
            robustness=robustness,
            axes=_axes(robustness),
            maps=_maps(robustness),
            outcomes=list(robustness_plots.OUTCOMES.values()),
            scale=robustness_plots.colour_scale(),
            longest=robustness_plots.LONGEST,
            sections=sections,
            data=embedded(_data(comparison, standings, robustness)),
        )
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)


def environment() -> Environment:
    """Return a Jinja environment for the templates of this package."""
    jinja = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.filters |= {"estimate": estimate, "shade": shade, "sortable": sortable, "format_number": format_number}
    return jinja


def estimate(interval: Interval) -> Markup:
    """Return HTML with a value and its interval."""
    value, _, ends = format_interval(interval).partition(" ")
    return Markup(f"{value} <small>{ends}</small>" if ends else value)


def sortable(value: float) -> str:
    """Return a number by which the page sorts a column; nan comes last."""
    return "1e99" if np.isnan(value) else f"{value:.6g}"


def shade(penalised_rmse: float) -> int:
    """Return the strength of a cell's background colour, %, from the logarithm of its penalised RMSE in mm."""
    share = np.log(max(penalised_rmse, _LIGHTEST) / _LIGHTEST) / np.log(_DARKEST / _LIGHTEST)
    return round(65.0 * min(float(share), 1.0))


def style(i: int) -> tuple[str, str]:
    """Return colour and dash pattern of policy i on the page, where black becomes the colour of the text."""
    return figures.colour(i).replace("#000000", "currentColor"), _DASHES[figures.LINES.index(figures.line(i))]


def embedded(data: Any) -> Markup:
    """Return JSON for a script element; ``<`` is escaped, so that the data cannot close the element."""
    return Markup(json.dumps(data, allow_nan=False).replace("<", "\\u003c"))


def _smallest_rmse(comparison: Comparison, scenario: str) -> float:
    """Return the smallest penalised RMSE in a scenario, mm."""
    return min(comparison.summaries[scenario, policy]["penalised_rmse"].value for policy in comparison.policies)


def _svg(figure: Any, name: str) -> Markup:
    return Markup(figures.to_svg(figure, name))


def _axes(robustness: Robustness | None) -> list[tuple[str, list[str], Markup]]:
    """Return label, tolerated range of each policy, and figure of every perturbation axis."""
    if not robustness:
        return []
    return [
        (
            axis.label,
            [format_tolerated_range(axis, robustness.curves[name, policy]) for policy in robustness.policies],
            _svg(robustness_plots.axis_figure(robustness, name), f"axis-{name}"),
        )
        for name, axis in robustness.axes.items()
    ]


def _maps(robustness: Robustness | None) -> list[tuple[str, list[tuple[float, Markup]]]]:
    """Return the title of every grid of starts and, for each policy, the share of recovered starts and the figure."""
    if not robustness:
        return []
    return [
        (
            grid.title,
            [
                (recovery.recovered, _svg(robustness_plots.map_figure(grid, recovery), f"map-{name}-{policy}"))
                for policy in robustness.policies
                for recovery in (robustness.recovery_maps[name, policy],)
            ],
        )
        for name, grid in robustness.start_grids.items()
    ]


def _error_figure(comparison: Comparison, scenario: str) -> Any:
    figure = figures.new_figure(3.8, 2.5)
    draw_errors(figures.add_axes(figure, 1, 1)[0, 0], comparison, scenario)
    return figure


def _data(comparison: Comparison, standings: Sequence[LeaderboardRow], robustness: Robustness | None) -> dict[str, Any]:
    return {
        "comparison": comparison.as_data(),
        "leaderboard": [to_json_data(row) for row in standings],
        "robustness": robustness.as_data() if robustness else None,
    }
