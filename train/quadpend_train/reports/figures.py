"""Figures for pages and documents: one style for every contender, and the same file whenever one is drawn."""

import io
import re
from pathlib import Path
from typing import Any

# Okabe and Ito's colours, distinguishable by the colour-blind.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
LINES: Any = ("-", "--", ":", "-.")
_METADATA: dict[str, None] = {"Date": None, "Creator": None, "Format": None, "Type": None}
_SETTINGS: Any = {"svg.fonttype": "none", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def colour(i: int) -> str:
    """Of contender i."""
    return COLOURS[i % len(COLOURS)]


def line(i: int) -> Any:
    """Line style of contender i: another one for each round of the colours."""
    return LINES[i // len(COLOURS) % len(LINES)]


def blank(width: float, height: float) -> Any:
    """An empty figure in inches, without pyplot and its global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def grid(figure: Any, rows: int, columns: int, **settings: Any) -> Any:
    """Axes of a figure in the house's style, shape (rows, columns)."""
    from matplotlib import rc_context

    with rc_context(_SETTINGS):
        return figure.subplots(rows, columns, squeeze=False, **settings)


def curve(axis: Any, i: int, x: Any, low: Any, middle: Any, high: Any, name: str = "") -> None:
    """Draw contender i's line in its band."""
    axis.fill_between(x, low, high, color=colour(i), alpha=0.15, linewidth=0, gid=f"contender{i}")
    axis.plot(x, middle, line(i), color=colour(i), linewidth=1.5, label=name, gid=f"contender{i}")


def logarithmic(axis: Any, low: float, high: float) -> None:
    """Give an axis a logarithmic scale upwards, with 1, 2, 5, 10 … written out."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    axis.set_yscale("log")
    axis.set_ylim(0.8 * low, 1.25 * high)
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,), numticks=12))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_locator(NullLocator())


def legend(figure: Any, names: tuple[str, ...]) -> None:
    """Name the contenders above a figure."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour(i), linestyle=line(i), label=name) for i, name in enumerate(names)]
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(names), 6), frameon=False)


def png(figure: Any, path: Path) -> None:
    """Write a PNG file."""
    figure.savefig(path, dpi=110, metadata={"Software": None})


def svg(figure: Any, name: str) -> str:
    """A figure as an element for a page, with what is black in the colour of the page's text.

    The contenders' parts have the attribute ``data-contender``. Paths are rounded to 0.1 points, and only ids that are
    referred to stay, which are those of no other figure if `name` is not.
    """
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({**_SETTINGS, "svg.hashsalt": name}):
        figure.savefig(text, format="svg", transparent=True, metadata=_METADATA)
    drawn = text.getvalue()
    box = re.search(r'viewBox="[^"]*"', drawn)
    body = drawn[drawn.index(">", drawn.index("<svg")) + 1 :]
    body = re.sub(r"<(metadata|style).*?</\1>|<defs>\s*</defs>", "", body, flags=re.DOTALL)
    body = re.sub(r'id="contender(\d+)"', r'data-contender="\1"', body)
    used = set(re.findall(r'#([\w-]+)["\)]', body))
    body = re.sub(r' id="([^"]+)"', lambda match: match[0] if match[1] in used else "", body)
    body = re.sub(r' d="[^"]*"', _shortened, body)
    body = body.replace("#000000", "currentColor")
    return f'<svg class="figure" role="img" fill="currentColor" {box[0] if box else ""}>{body}'


def _shortened(path: re.Match[str]) -> str:
    return " " + re.sub(r"(\.\d)\d+", r"\1", " ".join(path[0].split()))
