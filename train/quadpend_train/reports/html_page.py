"""A comparison, and how far its policies can be pushed, as one page that needs nothing else: no network, no files.

`report.html` beside this module is its template. All numbers are in the page again as JSON, in the element with the id
``data``, for whatever else is to be shown with them.
"""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from quadpend_train.common.files import to_json_data
from quadpend_train.evaluation.comparison import METRICS, Comparison
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.leaderboard import LeaderboardRow, leaderboard
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures, robustness_plots
from quadpend_train.reports.tables import COLUMNS, draw_errors
from quadpend_train.studies.robustness import Robustness, format_tolerated_range

_DASHES = ("", "5 3", "1.5 2.5", "6 2 1.5 2")  # as `figures.LINES`
_FINE, _GRAVE = 10.0, 1000.0  # mm of penalised RMSE, where the shading of a cell begins and ends


class Section(NamedTuple):
    """Another part of the page.

    Attributes:
        id: of the element.
        title: its heading.
        content: HTML; names in it must be escaped.
        style: HTML that it needs in the page's head.
    """

    id: str
    title: str
    content: Markup
    style: Markup = Markup("")


def write(
    comparison: Comparison,
    robustness: Robustness | None,
    path: Path,
    sections: Sequence[Section] = (),
    title: str = "Policies for a pendulum on a quadrotor, compared",
    date: str | None = None,
) -> None:
    """Write the page. Two are the same but for the line with the date.

    Args:
        comparison: what it is about.
        robustness: of the same policies in the same order; None: without.
        path: of the page.
        sections: to come after the duels.
        title: of the page.
        date: to stand in it; None: today's.

    Raises:
        ValueError: `robustness` is about other policies.
    """
    if robustness and robustness.policies != comparison.policies:
        raise ValueError(
            f"robustness must be of {', '.join(comparison.policies)}, not {', '.join(robustness.policies)}"
        )
    standings = leaderboard(comparison)
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
            least={name: _least(comparison, name) for name in comparison.scenarios},
            standings=standings,
            duels=[compare_pair(comparison, other, comparison.policies[0]) for other in comparison.policies[1:]],
            measures={name: METRICS[name] for name in COLUMNS},
            errors={name: _svg(_error_figure(comparison, name), f"error-{name}") for name in comparison.scenarios},
            robustness=robustness,
            axes=_axes(robustness),
            maps=_maps(robustness),
            outcomes=list(robustness_plots.OUTCOMES.values()),
            scale=robustness_plots.scale(),
            longest=robustness_plots.LONGEST,
            sections=sections,
            data=embedded(_data(comparison, standings, robustness)),
        )
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def environment() -> Environment:
    """Jinja's, for the templates beside this module."""
    made = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"estimate": estimate, "shade": shade, "sortable": sortable, "format_number": format_number}
    return made


def estimate(interval: Interval) -> Markup:
    """A number with its interval."""
    value, _, ends = format_interval(interval).partition(" ")
    return Markup(f"{value} <small>{ends}</small>" if ends else value)


def sortable(value: float) -> str:
    """A number to sort by; nan last."""
    return "1e99" if np.isnan(value) else f"{value:.6g}"


def shade(penalised_rmse: float) -> int:
    """How strongly to shade a cell, %, by the logarithm of its penalised RMSE in mm."""
    share = np.log(max(penalised_rmse, _FINE) / _FINE) / np.log(_GRAVE / _FINE)
    return round(65.0 * min(float(share), 1.0))


def _least(comparison: Comparison, scenario: str) -> float:
    """The smallest penalised RMSE in a scenario, mm."""
    return min(comparison.summaries[scenario, policy]["penalised_rmse"].value for policy in comparison.policies)


def style(i: int) -> tuple[str, str]:
    """Colour and dashes of contender i on the page, where black is the text's colour."""
    return figures.colour(i).replace("#000000", "currentColor"), _DASHES[figures.LINES.index(figures.line(i))]


def _svg(figure: Any, name: str) -> Markup:
    return Markup(figures.svg(figure, name))


def _axes(robustness: Robustness | None) -> list[tuple[str, list[str], Markup]]:
    """Of every axis its label, what each policy endures, and the figure."""
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
    """Of every map its title and, for every policy, the share that recovered and the figure."""
    if not robustness:
        return []
    return [
        (
            item.title,
            [
                (basin.recovered, _svg(robustness_plots.map_figure(item, basin), f"map-{name}-{policy}"))
                for policy in robustness.policies
                for basin in (robustness.recovery_maps[name, policy],)
            ],
        )
        for name, item in robustness.start_grids.items()
    ]


def _error_figure(comparison: Comparison, scenario: str) -> Any:
    figure = figures.blank(3.8, 2.5)
    draw_errors(figures.grid(figure, 1, 1)[0, 0], comparison, scenario)
    return figure


def _data(comparison: Comparison, standings: Sequence[LeaderboardRow], robustness: Robustness | None) -> dict[str, Any]:
    return {
        "comparison": comparison.as_data(),
        "leaderboard": [to_json_data(standing) for standing in standings],
        "robustness": robustness.as_data() if robustness else None,
    }


def embedded(data: Any) -> Markup:
    """JSON that no part of can end the element it stands in."""
    return Markup(json.dumps(data, allow_nan=False).replace("<", "\\u003c"))
