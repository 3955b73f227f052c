"""Plots of the ablations: survival and tracking error of the cases."""

from pathlib import Path
from typing import Any

import numpy as np

from quadpend_baselines.paper.ablations import EPISODES, AblationCase, AblationResult

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_MARKERS = ("o", "s", "^", "D")


def draw(results: list[tuple[AblationCase, AblationResult]], path: Path) -> None:
    """Draw the results and write the figure to `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(2, 2)
    _draw_lines(axes[0, 0], results, "noise", "survival", "noise {line:g} mm, mrad")
    axes[0, 0].set(xlabel="$ω_n$ of the observers (rad/s)", ylabel="survival (%)", xscale="log", title="noise")
    _draw_lines(axes[0, 1], results, "torque limit", "survival", "$ω_{{nc}}$ = {dash:g}, {line:g} N·m")
    axes[0, 1].set(xlabel="offset of the start (m)", ylabel="survival (%)", title="torque limit (matched)")
    _draw_lines(axes[1, 0], results, "wind", "rmse", "mismatch share {line:g}")
    axes[1, 0].set(xlabel="fluctuating wind, σ (N)", ylabel="settled RMSE (mm)", yscale="log", title="wind strength")
    _draw_lines(axes[1, 1], results, "frequency", "rmse", "mismatch share {line:g}")
    axes[1, 1].set(
        xlabel="frequency of a force of 0.3 N (rad/s)",
        ylabel="settled RMSE (mm)",
        yscale="log",
        title="wind frequency",
    )
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=7)
    figure.suptitle(f"Failures and remedies: every point is the result of {EPISODES} episodes of 10 s", fontsize=10)
    figure.savefig(path, dpi=150)


def _draw_lines(
    axis: Any, results: list[tuple[AblationCase, AblationResult]], group: str, metric: str, label: str
) -> None:
    """Draw one line for each colour ``"line"`` and each line style ``"dash"`` of the cases of a group.

    A case without a surviving episode has no RMSE and therefore no point.
    """
    chosen = [(case.plot_position, result) for case, result in results if case.group == group]
    lines = sorted({(position["line"], position.get("dash", 0.0)) for position, _ in chosen})
    dashes = sorted({dash for _, dash in lines})
    colours = sorted({line for line, _ in lines})
    for line, dash in lines:
        points = [
            (position["x"], getattr(result, metric))
            for position, result in chosen
            if (position["line"], position.get("dash", 0.0)) == (line, dash)
        ]
        x, y = np.array(sorted(points)).T
        i = colours.index(line)
        axis.plot(
            x,
            y * (100.0 if metric == "survival" else 1000.0),
            color=_COLOURS[i],
            marker=_MARKERS[i],
            markersize=4,
            linestyle="-" if dashes.index(dash) == 0 else "--",
            label=label.format(line=line, dash=dash),
        )
