"""Figures 4 to 10 of the paper in its layout, drawn from the results of `experiment` as PNG and SVG files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.paper.experiment import GUSTS, RECORDING_PERIOD, Experiment
from quadpend_baselines.paper.trajectory import Trajectory
from quadpend_gym import PAPER, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE, FORCE, THRUST, TORQUE

# The palette of Okabe and Ito for colour-blind readers; the line styles differ, for printing in black and white.
_STYLES = {
    "continuous": {"color": "#0072B2", "linestyle": "-"},
    "1 kHz": {"color": "#009E73", "linestyle": ":"},
    "100 Hz": {"color": "#D55E00", "linestyle": "--"},
}
_REFERENCE: dict[str, Any] = {"color": "#000000", "linestyle": "-.", "linewidth": 0.8, "label": "reference"}
_TRUE: dict[str, Any] = {"color": "#000000", "linestyle": "-", "linewidth": 0.8, "label": "true"}


class Panel(NamedTuple):
    """One panel of a figure.

    Attributes:
        label: Label of the y axis.
        series: Returns the values to draw from a trajectory, shape (m,).
        comparison: Returns the values to compare them with; None: no comparison.
        comparison_style: Line style of the comparison.
    """

    label: str
    series: Callable[[Trajectory], Floats]
    comparison: Callable[[Trajectory], Floats] | None = None
    comparison_style: dict[str, Any] | None = None


def _output(channel: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.outputs[:, channel]


def _reference(channel: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.reference[:, 0, channel]


def _error(channel: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.error[:, channel]


def _disturbance(column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.disturbance[:, column]


def _estimate(column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.estimate[:, column]


def _command(column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.command[:, column]


FIGURES: dict[str, tuple[str, tuple[Panel, ...]]] = {
    "figure_4": (
        "Tracking of the flat outputs",
        tuple(
            Panel(label, _output(i), _reference(i), _REFERENCE)
            for i, label in enumerate(("(a) $F_x$ (m)", "(b) $F_y$ (m)", "(c) $z$ (m)", "(d) ψ (rad)"))
        ),
    ),
    "figure_5": (
        "Attitude of the quadrotor",
        (
            Panel("(a) pitch θ (rad)", lambda trajectory: State(trajectory.state).euler[:, 1]),
            Panel("(b) roll φ (rad)", lambda trajectory: State(trajectory.state).euler[:, 0]),
        ),
    ),
    "figure_6": (
        "Tracking errors",
        tuple(
            Panel(label, _error(i))
            for i, label in enumerate(("(a) $e_{Fx}$ (m)", "(b) $e_{Fy}$ (m)", "(c) $e_z$ (m)", "(d) $e_ψ$ (rad)"))
        ),
    ),
    "figure_7": (
        "Angles of the pendulum",
        (
            Panel("(a) α (rad)", lambda trajectory: State(trajectory.state).alpha),
            Panel("(b) β (rad)", lambda trajectory: np.unwrap(State(trajectory.state).beta)),
            Panel("(c) $α_x$ (rad)", lambda trajectory: State(trajectory.state).alpha_x),
            Panel("(d) $α_y$ (rad)", lambda trajectory: State(trajectory.state).alpha_y),
        ),
    ),
    "figure_8": (
        "Disturbances, true and estimated",
        tuple(
            Panel(label, _estimate(column), _disturbance(column), _TRUE)
            for column, label in (
                (FORCE, "(a) force x (N)"),
                (FORCE + 1, "(b) force y (N)"),
                (FORCE + 2, "(c) force z (N)"),
                (TORQUE + 2, "(d) yaw torque (N·m)"),
            )
        ),
    ),
    "figure_9": (
        "Control signals",
        (
            Panel("(a) $τ_θ$ (N·m)", _command(COMMAND_TORQUE + 1)),
            Panel("(b) $τ_φ$ (N·m)", _command(COMMAND_TORQUE)),
            Panel("(c) $u$ (N)", _command(THRUST)),
            Panel("(d) $τ_ψ$ (N·m)", _command(COMMAND_TORQUE + 2)),
        ),
    ),
}


def draw(experiment: Experiment, folder: Path) -> list[Path]:
    """Write all figures into `folder` and return their paths."""
    import matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    # Without a date and with fixed ids, the SVG files are reproducible byte by byte.
    with matplotlib.rc_context({"svg.hashsalt": "quadpend", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figures = {name: _panels(experiment, title, panels) for name, (title, panels) in FIGURES.items()}
        figures["figure_10"] = _trajectory_figure(experiment.continuous)
        paths = []
        for name, figure in figures.items():
            for ending, options in ((".png", {"dpi": 200}), (".svg", {"metadata": {"Date": None}})):
                figure.savefig(folder / (name + ending), **options)
                paths.append(folder / (name + ending))
    return paths


def _figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _panels(experiment: Experiment, title: str, panels: tuple[Panel, ...]) -> Any:
    figure = _figure(7.5, 2.3 * (len(panels) // 2) + 0.5)
    axes = figure.subplots(len(panels) // 2, 2, sharex=True, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=True):
        for name, trajectory in experiment.trajectories.items():
            axis.plot(trajectory.time, panel.series(trajectory), linewidth=1.2, label=name, **_STYLES[name])
        if panel.comparison is not None:
            values = panel.comparison(experiment.continuous)
            axis.plot(experiment.continuous.time, values, **(panel.comparison_style or {}))
        axis.axvline(GUSTS.onset, color="#888888", linewidth=0.8)
        axis.set_ylabel(panel.label)
    for axis in axes[-2:]:
        axis.set_xlabel("time (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"{title} (gusts from {GUSTS.onset:g} s)", fontsize=10)
    return figure


def _trajectory_figure(trajectory: Trajectory) -> Any:
    """Draw Figure 10: the trajectory in space with the pendulum, and its three projections."""
    figure = _figure(8.5, 8.0)
    state = State(trajectory.state)
    bob = state.position + PAPER.rod_length * state.direction
    shown = slice(0, None, round(1.0 / RECORDING_PERIOD))  # one pendulum per second
    scene = figure.add_subplot(2, 2, 1, projection="3d")
    scene.plot(*state.position.T, color="#0072B2", linewidth=1.0, label="quadrotor")
    scene.plot(*bob.T, color="#D55E00", linewidth=1.0, label="bob")
    for pivot, tip in zip(state.position[shown], bob[shown], strict=True):
        scene.plot(*np.stack([pivot, tip]).T, color="#444444", linewidth=1.0)
    scene.scatter(*state.position[shown].T, color="#0072B2", marker="s", s=12)
    scene.scatter(*bob[shown].T, color="#D55E00", s=16)
    scene.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title="(a)")
    scene.set_box_aspect(None, zoom=0.85)
    scene.legend(frameon=False, fontsize=8)
    for place, (i, j), label in ((2, (0, 1), "(b)"), (3, (0, 2), "(c)"), (4, (1, 2), "(d)")):
        axis = figure.add_subplot(2, 2, place)
        axis.plot(state.position[:, i], state.position[:, j], color="#0072B2", linewidth=1.0)
        axis.plot(bob[:, i], bob[:, j], color="#D55E00", linewidth=1.0)
        for pivot, tip in zip(state.position[shown], bob[shown], strict=True):
            axis.plot([pivot[i], tip[i]], [pivot[j], tip[j]], color="#444444", linewidth=1.0)
        axis.set(xlabel=f"{'xyz'[i]} (m)", ylabel=f"{'xyz'[j]} (m)", title=label)
        axis.set_aspect("equal", adjustable="datalim")
    figure.suptitle("The trajectory, one pendulum per second", fontsize=10)
    return figure
