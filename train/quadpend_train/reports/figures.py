"""Figures for reports: every policy has one line style, and the same data always gives the same file."""

import io
import re
from pathlib import Path
from typing import Any

from quadpend_train.common.files import atomic

# Colours of Okabe and Ito, which people with colour-vision deficiencies can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
LINES: Any = ("-", "--", ":", "-.")
_METADATA: dict[str, None] = {"Date": None, "Creator": None, "Format": None, "Type": None}
_SETTINGS: Any = {"svg.fonttype": "none", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def colour(i: int) -> str:
    """Return the colour of policy i."""
    return COLOURS[i % len(COLOURS)]


def line(i: int) -> Any:
    """Return the line style of policy i. Policies with the same colour have different line styles."""
    return LINES[i // len(COLOURS) % len(LINES)]


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of a size in inches, without pyplot and its global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Any, rows: int, columns: int, **settings: Any) -> Any:
    """Add axes in the common style to a figure, and return them in an array of shape (rows, columns)."""
    from matplotlib import rc_context

    with rc_context(_SETTINGS):
        return figure.subplots(rows, columns, squeeze=False, **settings)


def draw_curve(axis: Any, i: int, x: Any, low: Any, middle: Any, high: Any) -> None:
    """Draw the line `middle` and the band from `low` to `high` of policy i over `x`, shape (n,) each."""
    axis.fill_between(x, low, high, color=colour(i), alpha=0.15, linewidth=0, gid=f"policy{i}-band")
    axis.plot(x, middle, line(i), color=colour(i), linewidth=1.5, gid=f"policy{i}-line")


def set_log_scale(axis: Any, low: float, high: float) -> None:
    """Give axes a logarithmic vertical scale from `low` to `high` with ticks at 1, 2, 5, 10 and so on."""
    axis.set_yscale("log")
    axis.set_ylim(0.8 * low, 1.25 * high)
    set_log_ticks(axis.yaxis, (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,))


def set_log_ticks(scale: Any, multiples: tuple[float, ...]) -> None:
    """Label a logarithmic scale at multiples of the powers of ten."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    scale.set_major_locator(LogLocator(subs=multiples, numticks=12))
    scale.set_major_formatter(StrMethodFormatter("{x:g}"))
    scale.set_minor_locator(NullLocator())


def write_png(figure: Any, path: Path) -> None:
    """Write a PNG file."""
    with atomic(path) as unfinished:
        figure.savefig(unfinished, dpi=110, metadata={"Software": None})


def to_svg(figure: Any, prefix: str) -> str:
    """Return a figure as an SVG element for an HTML page, in which black becomes the colour of the page's text.

    All ids begin with `prefix`, so they are unique on the page. Those of policy i contain ``-policy{i}-``.
    """
    from matplotlib import rc_context

    buffer = io.StringIO()
    with rc_context({**_SETTINGS, "svg.hashsalt": prefix}):
        figure.savefig(buffer, format="svg", transparent=True, metadata=_METADATA)
    text = re.sub(r'<(metadata|style).*?</\1>| xmlns[^"]*"[^"]*"', "", buffer.getvalue(), flags=re.DOTALL)
    body = re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{prefix}-", text[text.index("viewBox=") :])
    return f'<svg class="figure" role="img" fill="currentColor" {body.replace("#000000", "currentColor")}'
