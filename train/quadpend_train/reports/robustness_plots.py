"""Figures of the robustness: curves along each perturbation axis, and recovery maps."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadpend_train.common.text import figure_text
from quadpend_train.reports import figures
from quadpend_train.studies.recovery import RecoveryMap, RecoveryOutcome, StartGrid
from quadpend_train.studies.robustness import TOLERATED_SURVIVAL, Robustness

# Labels and colours of starts from which the policy does not recover; the colour of the others is the recovery time.
OUTCOMES = {RecoveryOutcome.FELL: ("fell", "#c9c9c9"), RecoveryOutcome.UNSETTLED: ("survived, not settled", "#D55E00")}
SCALE = "viridis_r"  # colours of the recovery time
LONGEST = 6.0  # s, end of the colour scale
_COLUMNS = 3


def axis_figure(robustness: Robustness, name: str, shares: Mapping[str, Sequence[float]] | None = None) -> Any:
    """Return a figure of survival and penalised RMSE along one perturbation axis.

    Args:
        robustness: Robustness.
        name: Name of the axis.
        shares: Labels and values of at most two shares that are drawn beside the survival; with one, the figure has a
            legend.
    """
    figure = figures.new_figure(7.5, 5.2) if shares else figures.new_figure(3.8, 3.9)
    (survival,), (rmse,) = figures.add_axes(figure, 2, 1, sharex=True)
    _draw_axis(survival, rmse, robustness, name)
    if shares:
        values = robustness.axes[name].values
        for (label, share), line in zip(shares.items(), ("--", "-.")[: len(shares)], strict=True):
            survival.plot(values, 100.0 * np.array(share), color="#777777", linestyle=line, label=label)
        survival.set_ylabel("survival, share of references (%)", fontsize=8)
        survival.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        figures.add_legend(figure, robustness.policies)
    return figure


def curves(robustness: Robustness) -> Any:
    """Return a figure of survival and penalised RMSE along all perturbation axes."""
    rows = -(-len(robustness.axes) // _COLUMNS)
    figure = figures.new_figure(3.6 * _COLUMNS, 3.4 * rows + 0.4)
    axes = figures.add_axes(figure, 2 * rows, _COLUMNS)
    for i, name in enumerate(robustness.axes):
        row, column = divmod(i, _COLUMNS)
        _draw_axis(axes[2 * row, column], axes[2 * row + 1, column], robustness, name)
    for axis in axes.ravel():
        if not axis.has_data():
            axis.set_axis_off()
    figures.add_legend(figure, robustness.policies)
    return figure


def _draw_axis(survival: Any, rmse: Any, robustness: Robustness, name: str) -> None:
    axis = robustness.axes[name]
    for i, policy in enumerate(robustness.policies):
        points = robustness.curves[name, policy]
        values = [point.value for point in points]
        middle, low, high = 100.0 * np.array([point.survival for point in points]).T
        figures.draw_curve(survival, i, values, low, middle, high)
        middle, low, high = 1000.0 * np.array([point.penalised_rmse for point in points]).T
        figures.draw_curve(rmse, i, values, low, middle, high)
        rmse.plot(values, middle, ".", color=figures.colour(i), markersize=4, gid=f"policy{i}")
    survival.axhline(100.0 * TOLERATED_SURVIVAL, color="#888888", linewidth=0.8, linestyle=":")
    survival.set(ylabel="survival (%)", ylim=(-3.0, 103.0))
    rmse.set(ylabel="penalised RMSE (mm)", xlabel=axis.label)
    figures.set_log_scale(rmse, *_extent(robustness))
    for part in (survival, rmse):
        if axis.scale == "symlog":
            part.set_xscale("symlog", linthresh=axis.values[1], linscale=0.4)
            part.set_xticks(axis.values, [f"{value:g}" for value in axis.values], fontsize=8)
            part.minorticks_off()
        part.set_xlim(axis.values[0], axis.values[-1])
        part.grid(alpha=0.25)


def _extent(robustness: Robustness) -> tuple[float, float]:
    """Return the smallest and largest penalised RMSE over all axes, mm: all figures share this scale."""
    values = np.array([point.penalised_rmse for points in robustness.curves.values() for point in points])
    shown = 1000.0 * values[values > 0.0]  # the lower end of an interval may be 0
    return (float(shown.min()), float(shown.max())) if shown.size else (1.0, 1000.0)


def map_figure(grid: StartGrid, recovery: RecoveryMap) -> Any:
    """Return a figure of the recovery map of one policy, without a title."""
    figure = figures.new_figure(3.0, 2.7)
    ((axis,),) = figures.add_axes(figure, 1, 1)
    _draw_map(axis, grid, recovery)
    return figure


def maps(robustness: Robustness, name: str) -> Any:
    """Return a figure of the recovery maps of all policies on one grid of starts."""
    grid, columns = robustness.start_grids[name], min(len(robustness.policies), 4)
    rows = -(-len(robustness.policies) // columns)
    figure = figures.new_figure(2.7 * columns + 0.8, 2.6 * rows + 0.5)
    axes = figures.add_axes(figure, rows, columns, sharex=True, sharey=True)
    for axis in axes.ravel()[len(robustness.policies) :]:
        axis.set_axis_off()
    for axis, policy in zip(axes.ravel(), robustness.policies, strict=False):
        recovery = robustness.recovery_maps[name, policy]
        image = _draw_map(axis, grid, recovery)
        axis.set_title(f"{figure_text(policy)}: {100.0 * recovery.recovered:.0f} %", fontsize=9)
        axis.label_outer()
    figure.colorbar(image, ax=axes, label="time to recover (s)", shrink=0.7)
    _outcome_legend(figure)
    return figure


def _outcome_legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=label) for label, colour in OUTCOMES.values()]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)


def _draw_map(axis: Any, grid: StartGrid, recovery: RecoveryMap) -> Any:
    """Draw a recovery map; of several training seeds, the outcome of most seeds and the mean recovery time."""
    from matplotlib.colors import ListedColormap

    outcome = np.median(recovery.outcome, axis=0)
    recovered = outcome > RecoveryOutcome.UNSETTLED
    known = ~np.isnan(recovery.time)
    time = np.where(known, recovery.time, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    extent = [*_outer_edges(grid.x.values), *_outer_edges(grid.y.values)]
    options: dict[str, Any] = {"origin": "lower", "aspect": "auto", "extent": extent, "interpolation": "none"}
    background = ListedColormap([colour for _, colour in OUTCOMES.values()])
    axis.imshow(outcome >= RecoveryOutcome.UNSETTLED, cmap=background, vmin=0, vmax=1, **options)
    image = axis.imshow(np.ma.masked_where(~recovered, time), cmap=SCALE, vmin=0.0, vmax=LONGEST, **options)
    axis.locator_params(nbins=5)
    axis.set(xlabel=f"{grid.x.title} ({grid.x.unit})", ylabel=f"{grid.y.title} ({grid.y.unit})")
    return image


def colour_scale(steps: int = 9) -> list[str]:
    """Return the colours of recovery times from 0 to `LONGEST`, as CSS colours.

    Args:
        steps: Number of colours.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colour) for colour in colormaps[SCALE](np.linspace(0.0, 1.0, steps))]


def _outer_edges(values: Any) -> tuple[float, float]:
    """Return the outer edges of the first and the last cell around equidistant values."""
    half = 0.5 * (values[1] - values[0])
    return float(values[0] - half), float(values[-1] + half)
