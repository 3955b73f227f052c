"""The report of a comparison as one HTML page, which needs no network and no other files.

`templates/report.html` is its template. The page also contains all numbers as JSON, in the element with the id
``data``.
"""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from quadpend_train.common.files import to_json_data, write_text
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.leaderboard import LeaderboardRow
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.evaluation.table import METRICS, cells, differences
from quadpend_train.reports import figures
from quadpend_train.reports.tables import METRIC_COLUMNS, draw_errors, episodes_note, sentences

_DASHES = ("", "5 3", "1.5 2.5", "6 2 1.5 2")  # of SVG lines, in the order of `figures.LINES`
_LIGHTEST, _DARKEST = 10.0, 1000.0  # penalised RMSE of the lightest and of the darkest cells, mm


def write(
    comparison: Comparison,
    standings: Sequence[LeaderboardRow],
    path: Path,
    replay: dict[str, Any] | None = None,
    date: str | None = None,
) -> None:
    """Write the page of a comparison, its leaderboard, and the data of `record_replay` if there are any.

    Pages of the same data differ only in the line with the date; None is today in UTC.
    """
    jinja = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.filters |= {"estimate": estimate, "shade": shade, "sortable": sortable, "format_number": format_number}
    text = jinja.get_template("report.html").render(
        title="Comparison of policies for a pendulum on a quadrotor",
        date=date or datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        comparison=comparison,
        provenance=comparison.table.attrs["provenance"],
        policies=comparison.policies,
        styles=[style(i) for i in range(len(comparison.policies))],
        smallest_rmse={
            name: min(comparison.summaries[name, policy]["penalised_rmse"].value for policy in comparison.policies)
            for name in comparison.scenarios
        },
        standings=standings,
        episodes_note=episodes_note(comparison),
        sentences=sentences(comparison),
        metrics={name: METRICS[name] for name in METRIC_COLUMNS},
        errors={name: _error_figure(comparison, name) for name in comparison.scenarios},
        replay=embedded(replay) if replay else None,
        data=embedded({"comparison": as_data(comparison), "leaderboard": [to_json_data(row) for row in standings]}),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)


def as_data(comparison: Comparison) -> dict[str, Any]:
    """Return provenance, metrics and differences from the first policy as data for JSON."""
    values, first = cells(comparison.table), comparison.policies[0]
    return {
        **comparison.table.attrs,
        "units": {name: metric.unit for name, metric in METRICS.items()},
        "results": {
            scenario: {
                policy: {
                    "metrics": to_json_data(comparison.summaries[scenario, policy]),
                    "differences_from_first": to_json_data(
                        differences(values[scenario, policy], values[scenario, first])
                    ),
                }
                for policy in comparison.policies
            }
            for scenario in comparison.scenarios
        },
    }


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


def _error_figure(comparison: Comparison, scenario: str) -> Markup:
    figure = figures.new_figure(3.8, 2.5)
    draw_errors(figures.add_axes(figure, 1, 1)[0, 0], comparison, scenario)
    return Markup(figures.to_svg(figure, f"error-{scenario}"))
