"""The paper's Figures 4 to 10, as it lays them out, from our experiment; PNG and SVG."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.paper.experiment import GUSTS, Experiment
from quadpend_baselines.paper.trajectory import Trajectory
from quadpend_gym import PAPER, State
from quadpend_gym.core.arrays import Floats

# Okabe and Ito's colours, distinguishable by the colour-blind; the styles tell the lines apart in black and white.
_STYLES = {
    "continuous": {"color": "#0072B2", "linestyle": "-"},
    "1 kHz": {"color": "#009E73", "linestyle": ":"},
    "100 Hz": {"color": "#D55E00", "linestyle": "--"},
}
_REFERENCE = {"color": "#000000", "linestyle": "-.", "linewidth": 0.8, "label": "reference"}
_TRUE = {"color": "#000000", "linestyle": "-", "linewidth": 0.8, "label": "true"}


class Panel(NamedTuple):
    """One panel: its label, and the series it draws of a trajectory, and what to draw these against."""

    label: str
    series: Callable[[Trajectory], Floats]
    against: Callable[[Trajectory], Floats] | None = None


def _output(channel: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.outputs[:, channel]


def _wanted(channel: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.reference[:, 0, channel]


def _error(channel: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.error[:, channel]


def _true(column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.disturbance[:, column]


def _seen(column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.estimate[:, column]


def _command(column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: trajectory.command[:, column]


FIGURES: dict[str, tuple[str, tuple[Panel, ...]]] = {
    "figure_4": (
        "Tracking of the flat outputs",
        tuple(
            Panel(label, _output(i), _wanted(i))
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
            Panel(label, _seen(column), _true(column))
            for column, label in (
                (0, "(a) force x (N)"),
                (1, "(b) force y (N)"),
                (2, "(c) force z (N)"),
                (8, "(d) yaw torque (N·m)"),
            )
        ),
    ),
    "figure_9": (
        "Control signals",
        (
            Panel("(a) $τ_θ$ (N·m)", _command(2)),
            Panel("(b) $τ_φ$ (N·m)", _command(1)),
            Panel("(c) $u$ (N)", _command(0)),
            Panel("(d) $τ_ψ$ (N·m)", _command(3)),
        ),
    ),
}


def draw(experiment: Experiment, folder: Path) -> list[Path]:
    """Write all figures into `folder`; their paths."""
    import matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    # SVGs without a date and with fixed ids are the same bytes every time.
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
        if panel.against is not None:
            style = _TRUE if panel.against.__qualname__.startswith("_true") else _REFERENCE
            axis.plot(experiment.continuous.time, panel.against(experiment.continuous), **style)
        axis.axvline(GUSTS.onset, color="#888888", linewidth=0.8)
        axis.set_ylabel(panel.label)
    for axis in axes[-2:]:
        axis.set_xlabel("time (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"{title} (gusts from {GUSTS.onset:g} s)", fontsize=10)
    return figure


def _trajectory_figure(trajectory: Trajectory) -> Any:
    """Figure 10: the trajectory in space with the pendulum drawn, and its three projections."""
    figure = _figure(8.5, 8.0)
    view = State(trajectory.state)
    bob = view.position + PAPER.rod_length * view.direction
    shown = slice(0, None, 100)  # one pendulum a second
    scene = figure.add_subplot(2, 2, 1, projection="3d")
    scene.plot(*view.position.T, color="#0072B2", linewidth=1.0, label="quadrotor")
    scene.plot(*bob.T, color="#D55E00", linewidth=1.0, label="bob")
    for foot, tip in zip(view.position[shown], bob[shown], strict=True):
        scene.plot(*np.stack([foot, tip]).T, color="#444444", linewidth=1.0)
    scene.scatter(*view.position[shown].T, color="#0072B2", marker="s", s=12)
    scene.scatter(*bob[shown].T, color="#D55E00", s=16)
    scene.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title="(a)")
    scene.set_box_aspect(None, zoom=0.85)
    scene.legend(frameon=False, fontsize=8)
    for place, (i, j), label in ((2, (0, 1), "(b)"), (3, (0, 2), "(c)"), (4, (1, 2), "(d)")):
        axis = figure.add_subplot(2, 2, place)
        axis.plot(view.position[:, i], view.position[:, j], color="#0072B2", linewidth=1.0)
        axis.plot(bob[:, i], bob[:, j], color="#D55E00", linewidth=1.0)
        for foot, tip in zip(view.position[shown], bob[shown], strict=True):
            axis.plot([foot[i], tip[i]], [foot[j], tip[j]], color="#444444", linewidth=1.0)
        axis.set(xlabel=f"{'xyz'[i]} (m)", ylabel=f"{'xyz'[j]} (m)", title=label)
        axis.set_aspect("equal", adjustable="datalim")
    figure.suptitle("The trajectory, one pendulum a second", fontsize=10)
    return figure
