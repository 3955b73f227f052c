"""Pictures of robustness: curves along each axis, and maps of what becomes of each start."""

from typing import Any

import numpy as np

from quadpend_train.reports import figures
from quadpend_train.studies.recovery import RecoveryMap, RecoveryOutcome, StartGrid
from quadpend_train.studies.robustness import TOLERATED_SURVIVAL, Robustness

# Those that fell, and those that survived without settling; the others are coloured by their time to recover.
OUTCOMES = {RecoveryOutcome.FELL: ("fell", "#c9c9c9"), RecoveryOutcome.UNSETTLED: ("survived, not settled", "#D55E00")}
SCALE = "viridis_r"  # of the time to recover
LONGEST = 6.0  # s, end of the colour scale
_COLUMNS = 3


def axis_figure(robustness: Robustness, name: str) -> Any:
    """Survival above, penalised tracking error below, along one axis."""
    figure = figures.blank(3.8, 3.9)
    (survival,), (rmse,) = figures.grid(figure, 2, 1, sharex=True)
    _draw_axis(survival, rmse, robustness, name)
    return figure


def curves(robustness: Robustness) -> Any:
    """The same along all axes in one figure."""
    rows = -(-len(robustness.axes) // _COLUMNS)
    figure = figures.blank(3.6 * _COLUMNS, 3.4 * rows + 0.4)
    axes = figures.grid(figure, 2 * rows, _COLUMNS)
    for i, name in enumerate(robustness.axes):
        row, column = divmod(i, _COLUMNS)
        _draw_axis(axes[2 * row, column], axes[2 * row + 1, column], robustness, name)
    for axis in axes.ravel():
        if not axis.has_data():
            axis.set_axis_off()
    figures.legend(figure, robustness.policies)
    return figure


def _draw_axis(survival: Any, rmse: Any, robustness: Robustness, name: str) -> None:
    axis = robustness.axes[name]
    for i, policy in enumerate(robustness.policies):
        points = robustness.curves[name, policy]
        values = [point.value for point in points]
        middle, low, high = 100.0 * np.array([point.survival for point in points]).T
        figures.curve(survival, i, values, low, middle, high)
        middle, low, high = 1000.0 * np.array([point.penalised_rmse for point in points]).T
        figures.curve(rmse, i, values, low, middle, high)
        rmse.plot(values, middle, ".", color=figures.colour(i), markersize=4, gid=f"contender{i}")
    survival.axhline(100.0 * TOLERATED_SURVIVAL, color="#888888", linewidth=0.8, linestyle=":")
    survival.set(ylabel="survival (%)", ylim=(-3.0, 103.0))
    rmse.set(ylabel="penalised RMSE (mm)", xlabel=axis.label)
    figures.logarithmic(rmse, *_extent(robustness))
    for part in (survival, rmse):
        if axis.scale == "symlog":
            part.set_xscale("symlog", linthresh=axis.values[1], linscale=0.4)
            part.set_xticks(axis.values, [f"{value:g}" for value in axis.values], fontsize=8)
            part.minorticks_off()
        part.set_xlim(axis.values[0], axis.values[-1])
        part.grid(alpha=0.25)


def _extent(robustness: Robustness) -> tuple[float, float]:
    """Smallest and largest penalised RMSE on all axes, mm, so that they can be drawn on one scale."""
    values = np.array([point.penalised_rmse for points in robustness.curves.values() for point in points])
    return (1000.0 * np.nanmin(values), 1000.0 * np.nanmax(values)) if np.isfinite(values).any() else (1.0, 1000.0)


def map_figure(item: StartGrid, basin: RecoveryMap) -> Any:
    """One policy's map, without a title."""
    figure = figures.blank(3.0, 2.7)
    ((axis,),) = figures.grid(figure, 1, 1)
    _draw_map(axis, item, basin)
    return figure


def maps(robustness: Robustness, name: str) -> Any:
    """One map of all policies in one figure."""
    item, columns = robustness.start_grids[name], min(len(robustness.policies), 4)
    rows = -(-len(robustness.policies) // columns)
    figure = figures.blank(2.7 * columns + 0.8, 2.6 * rows + 0.5)
    axes = figures.grid(figure, rows, columns, sharex=True, sharey=True)
    for axis in axes.ravel()[len(robustness.policies) :]:
        axis.set_axis_off()
    for axis, policy in zip(axes.ravel(), robustness.policies, strict=False):
        basin = robustness.recovery_maps[name, policy]
        image = _draw_map(axis, item, basin)
        axis.set_title(f"{policy}: {100.0 * basin.recovered:.0f} %", fontsize=9)
        axis.label_outer()
    figure.colorbar(image, ax=axes, label="time to recover (s)", shrink=0.7)
    _outcome_legend(figure)
    return figure


def _outcome_legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=label) for label, colour in OUTCOMES.values()]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)


def _draw_map(axis: Any, item: StartGrid, basin: RecoveryMap) -> Any:
    """Draw a map; of several training seeds, what most of them do and how long these take."""
    from matplotlib.colors import ListedColormap

    outcome = np.median(basin.outcome, axis=0)
    recovered = outcome > RecoveryOutcome.UNSETTLED
    known = ~np.isnan(basin.time)
    time = np.where(known, basin.time, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    extent = [*_ends(item.x.values), *_ends(item.y.values)]
    place: dict[str, Any] = {"origin": "lower", "aspect": "auto", "extent": extent, "interpolation": "none"}
    backdrop = ListedColormap([colour for _, colour in OUTCOMES.values()])
    axis.imshow(outcome >= RecoveryOutcome.UNSETTLED, cmap=backdrop, vmin=0, vmax=1, **place)
    image = axis.imshow(np.ma.masked_where(~recovered, time), cmap=SCALE, vmin=0.0, vmax=LONGEST, **place)
    axis.locator_params(nbins=5)
    axis.set(xlabel=f"{item.x.title} ({item.x.unit})", ylabel=f"{item.y.title} ({item.y.unit})")
    return image


def scale(steps: int = 9) -> list[str]:
    """Colours from a time to recover of 0 to `LONGEST`, for a page."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colour) for colour in colormaps[SCALE](np.linspace(0.0, 1.0, steps))]


def _ends(values: Any) -> tuple[float, float]:
    """Outer ends of the cells around equidistant values."""
    half = 0.5 * (values[1] - values[0])
    return float(values[0] - half), float(values[-1] + half)
