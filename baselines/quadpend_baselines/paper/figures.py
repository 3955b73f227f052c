"""Figures 4 to 10 of the paper in its layout, drawn from the results of `experiment` as PNG and SVG files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.paper.continuous import Trajectory
from quadpend_baselines.paper.experiment import GUSTS, RECORDING_PERIOD, Experiment
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
    """One panel of a figure: its label, the values to draw from a trajectory, and values to compare them with."""

    label: str
    series: Callable[[Trajectory], Floats]
    comparison: Callable[[Trajectory], Floats] | None = None
    comparison_style: dict[str, Any] = _REFERENCE


def _column(name: str, column: int) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: np.asarray(getattr(trajectory, name)[:, column])


def _state(values: Callable[[State], Floats]) -> Callable[[Trajectory], Floats]:
    return lambda trajectory: values(State(trajectory.state))


FIGURES: dict[str, tuple[str, list[Panel]]] = {
    "figure_4": (
        "Tracking of the flat outputs",
        [
            Panel(f"({'abcd'[i]}) {name}", _column("outputs", i), _column("wanted", i))
            for i, name in enumerate(("$F_x$ (m)", "$F_y$ (m)", "$z$ (m)", "ψ (rad)"))
        ],
    ),
    "figure_5": (
        "Attitude of the quadrotor",
        [
            Panel("(a) pitch θ (rad)", _state(lambda s: s.euler[:, 1])),
            Panel("(b) roll φ (rad)", _state(lambda s: s.euler[:, 0])),
        ],
    ),
    "figure_6": (
        "Tracking errors",
        [
            Panel(f"({'abcd'[i]}) {name}", _column("error", i))
            for i, name in enumerate(("$e_{Fx}$ (m)", "$e_{Fy}$ (m)", "$e_z$ (m)", "$e_ψ$ (rad)"))
        ],
    ),
    "figure_7": (
        "Angles of the pendulum",
        [
            Panel("(a) α (rad)", _state(lambda s: s.alpha)),
            Panel("(b) β (rad)", _state(lambda s: np.unwrap(s.beta))),
            Panel("(c) $α_x$ (rad)", _state(lambda s: s.alpha_x)),
            Panel("(d) $α_y$ (rad)", _state(lambda s: s.alpha_y)),
        ],
    ),
    "figure_8": (
        "Disturbances, true and estimated",
        [
            Panel(label, _column("estimate", column), _column("disturbance", column), _TRUE)
            for column, label in (
                (FORCE, "(a) force x (N)"),
                (FORCE + 1, "(b) force y (N)"),
                (FORCE + 2, "(c) force z (N)"),
                (TORQUE + 2, "(d) yaw torque (N·m)"),
            )
        ],
    ),
    "figure_9": (
        "Control signals",
        [
            Panel("(a) $τ_θ$ (N·m)", _column("command", COMMAND_TORQUE + 1)),
            Panel("(b) $τ_φ$ (N·m)", _column("command", COMMAND_TORQUE)),
            Panel("(c) $u$ (N)", _column("command", THRUST)),
            Panel("(d) $τ_ψ$ (N·m)", _column("command", COMMAND_TORQUE + 2)),
        ],
    ),
}


def draw(experiment: Experiment, folder: Path) -> list[Path]:
    """Write all figures into `folder` and return their paths."""
    import matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    # Without a date and with fixed ids, the SVG files are reproducible byte by byte.
    with matplotlib.rc_context({"svg.hashsalt": "quadpend", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figures = {name: _panels(experiment, title, panels) for name, (title, panels) in FIGURES.items()}
        figures["figure_10"] = _trajectory_figure(experiment["continuous"])
        paths = []
        for name, figure in figures.items():
            for ending, options in ((".png", {"dpi": 200}), (".svg", {"metadata": {"Date": None}})):
                figure.savefig(folder / (name + ending), **options)
                paths.append(folder / (name + ending))
    return paths


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _panels(experiment: Experiment, title: str, panels: list[Panel]) -> Any:
    figure = _figure(7.5, 2.3 * (len(panels) // 2) + 0.5)
    axes = figure.subplots(len(panels) // 2, 2, sharex=True, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=True):
        for name, trajectory in experiment.items():
            axis.plot(trajectory.time, panel.series(trajectory), linewidth=1.2, label=name, **_STYLES[name])
        if panel.comparison is not None:
            values = panel.comparison(experiment["continuous"])
            axis.plot(experiment["continuous"].time, values, **panel.comparison_style)
        axis.axvline(GUSTS.onset, color="#888888", linewidth=0.8)
        axis.set_ylabel(panel.label)
    for axis in axes[-2:]:
        axis.set_xlabel("time (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"{title} (gusts from {GUSTS.onset:g} s)", fontsize=10)
    return figure


def _trajectory_figure(trajectory: Trajectory) -> Any:
    """Draw Figure 10: the trajectory in space with one pendulum per second, and its three projections."""
    figure = _figure(8.5, 8.0)
    state, every = State(trajectory.state), round(1.0 / RECORDING_PERIOD)
    quadrotor, bob = state.position, state.position + PAPER.rod_length * state.direction
    for place, axes, label in ((1, [0, 1, 2], "(a)"), (2, [0, 1], "(b)"), (3, [0, 2], "(c)"), (4, [1, 2], "(d)")):
        axis = figure.add_subplot(2, 2, place, projection="3d" if place == 1 else None)
        axis.plot(*quadrotor[:, axes].T, color="#0072B2", linewidth=1.0, label="quadrotor")
        axis.plot(*bob[:, axes].T, color="#D55E00", linewidth=1.0, label="bob")
        for rod in np.stack([quadrotor, bob], axis=1)[::every, :, axes]:
            axis.plot(*rod.T, color="#444444", linewidth=1.0)
        axis.set(title=label, **{f"{'xyz'[i]}label": f"{'xyz'[j]} (m)" for i, j in enumerate(axes)})
        if place == 1:
            axis.scatter(*quadrotor[::every].T, color="#0072B2", marker="s", s=12)
            axis.scatter(*bob[::every].T, color="#D55E00", s=16)
            axis.set_box_aspect(None, zoom=0.85)
            axis.legend(frameon=False, fontsize=8)
        else:
            axis.set_aspect("equal", adjustable="datalim")
    figure.suptitle("The trajectory, one pendulum per second", fontsize=10)
    return figure
