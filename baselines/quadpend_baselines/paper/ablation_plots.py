"""Small multiples of the ablations: where the trajectory ends, and how large the error is on the way there."""

from pathlib import Path
from typing import Any

import numpy as np

from quadpend_baselines.paper.ablations import AblationCase, AblationResult

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_MARKERS = ("o", "s", "^", "D")


def draw(results: list[tuple[AblationCase, AblationResult]], path: Path) -> None:
    """Write the plots to `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(2, 2)
    _lines(axes[0, 0], results, "noise", "survival", "noise {line:g} mm, mrad")
    axes[0, 0].set(xlabel="$ω_n$ of the observers (rad/s)", ylabel="survival (%)", xscale="log", title="noise")
    _lines(axes[0, 1], results, "authority", "survival", "$ω_{{nc}}$ = {dash:g}, {line:g} N·m")
    axes[0, 1].set(xlabel="start beside the reference (m)", ylabel="survival (%)", title="authority (matched)")
    _lines(axes[1, 0], results, "wind", "rmse", "mismatch fed back: {line:g}")
    axes[1, 0].set(xlabel="fluctuating wind, σ (N)", ylabel="settled RMSE (mm)", yscale="log", title="wind strength")
    _lines(axes[1, 1], results, "frequency", "rmse", "mismatch fed back: {line:g}")
    axes[1, 1].set(xlabel="0.3 N at (rad/s)", ylabel="settled RMSE (mm)", yscale="log", title="frequency")
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=7)
    figure.suptitle("What ends the trajectory, and what cures it: 50 episodes of 10 s in each point", fontsize=10)
    figure.savefig(path, dpi=150)


def _lines(axis: Any, results: list[tuple[AblationCase, AblationResult]], group: str, measure: str, label: str) -> None:
    """One line for each value of `line` (colour) and `dash` (style); a missing point is a case nobody survived."""
    chosen = [(case.place, result) for case, result in results if case.group == group]
    keys = sorted({(place["line"], place.get("dash", 0.0)) for place, _ in chosen})
    dashes = sorted({dash for _, dash in keys})
    colours = sorted({line for line, _ in keys})
    for line, dash in keys:
        points = [(p["x"], getattr(r, measure)) for p, r in chosen if (p["line"], p.get("dash", 0.0)) == (line, dash)]
        x, y = np.array(sorted(points)).T
        i = colours.index(line)
        axis.plot(
            x,
            y * (100.0 if measure == "survival" else 1000.0),
            color=_COLOURS[i],
            marker=_MARKERS[i],
            markersize=4,
            linestyle="-" if dashes.index(dash) == 0 else "--",
            label=label.format(line=line, dash=dash),
        )
