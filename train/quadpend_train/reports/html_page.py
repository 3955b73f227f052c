"""The report of a comparison as one HTML page, which needs no network and no other files.

`templates/report.html` is its template.
"""

import datetime
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.metrics import METRICS
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures
from quadpend_train.reports.tables import (
    METRIC_COLUMNS,
    draw_errors,
    episodes_note,
    ranking_note,
    ranking_rows,
    sentences,
)

_DASHES = ("", "5 3", "1.5 2.5", "6 2 1.5 2")  # of SVG lines, in the order of `figures.LINES`


def write(comparison: Comparison, path: Path) -> None:
    """Write the page of a comparison."""
    folder = Path(__file__).with_name("templates")
    jinja = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.filters |= {"estimate": _estimate, "format_number": format_number}
    text = jinja.get_template("report.html").render(
        date=datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        comparison=comparison,
        styles=[style(i) for i in range(len(comparison.policies))],
        smallest_rmse={
            name: min(comparison.summaries[name, policy]["penalised_rmse"].value for policy in comparison.policies)
            for name in comparison.scenarios
        },
        hardest_seeds={name: _hardest_seed(comparison, name) for name in comparison.scenarios},
        ranking=ranking_rows(comparison),
        ranking_note=ranking_note(comparison),
        episodes_note=episodes_note(comparison),
        sentences=sentences(comparison),
        metrics={name: METRICS[name] for name in METRIC_COLUMNS},
        errors={name: _error_figure(comparison, name, f"errors{i}") for i, name in enumerate(comparison.scenarios)},
    )
    write_text(path, text)


def style(i: int) -> dict[str, str]:
    """Return colour and dash pattern of policy i on the page, where black becomes the colour of the text."""
    dashes = _DASHES[figures.LINES.index(figures.line(i))]
    return {"colour": figures.colour(i).replace("#000000", "currentColor"), "dashes": dashes}


def _estimate(interval: Interval) -> Markup:
    value, _, ends = format_interval(interval).partition(" ")
    return Markup(f"{value} <small>{ends}</small>" if ends else value)


def _hardest_seed(comparison: Comparison, scenario: str) -> int:
    """Return the seed of the episode with the largest penalised RMSE, averaged over policies and training seeds."""
    table = comparison.table[comparison.table["scenario"] == scenario]
    by_policy = table.groupby(["episode", "policy"])["penalised_rmse"].mean()
    return int(comparison.table.attrs["seed"] + by_policy.groupby("episode").mean().idxmax())


def _error_figure(comparison: Comparison, scenario: str, prefix: str) -> Markup:
    figure = figures.new_figure(3.8, 2.5)
    draw_errors(figures.add_axes(figure, 1, 1)[0, 0], comparison, scenario)
    return Markup(figures.to_svg(figure, prefix))
