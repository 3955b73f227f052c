"""Figures 4 to 10 of the paper in its layout, drawn from the results of `experiment` as PNG and SVG files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.paper.continuous import Trajectory
from quadpend_baselines.paper.experiment import GUST_COLUMNS, GUSTS, RECORDING_PERIOD, Experiment
from quadpend_gym import PAPER, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE, THRUST

# The palette of Okabe and Ito for colour-blind readers; the line styles differ, for printing in black and white.
_STYLES = {
    "continuous": {"color": "#0072B2", "linestyle": "-"},
    "1 kHz": {"color": "#009E73", "linestyle": ":"},
    "100 Hz": {"color": "#D55E00", "linestyle": "--"},
}
_COMMANDS = [COMMAND_TORQUE + 1, COMMAND_TORQUE, THRUST, COMMAND_TORQUE + 2]


class _Figure(NamedTuple):
    """A figure with one panel for each label, which shows a column of `values` and of what they are compared with."""

    title: str
    labels: tuple[str, ...]
    values: Callable[[Trajectory], Floats]
    compared: Callable[[Trajectory], Floats] | None = None
    name: str = ""  # of what they are compared with
    line: str = "-"


def _angles(trajectory: Trajectory) -> Floats:
    state = State(trajectory.state)
    return np.stack([state.alpha, np.unwrap(state.beta), state.alpha_x, state.alpha_y], axis=1)


FIGURES = {
    "figure_4": _Figure(
        "Tracking of the flat outputs",
        ("$F_x$ (m)", "$F_y$ (m)", "$z$ (m)", "ψ (rad)"),
        lambda t: t.outputs,
        lambda t: t.reference[:, 0],
        "reference",
        "-.",
    ),
    "figure_5": _Figure(
        "Attitude of the quadrotor", ("pitch θ (rad)", "roll φ (rad)"), lambda t: State(t.state).euler[:, [1, 0]]
    ),
    "figure_6": _Figure(
        "Tracking errors", ("$e_{Fx}$ (m)", "$e_{Fy}$ (m)", "$e_z$ (m)", "$e_ψ$ (rad)"), lambda t: t.error
    ),
    "figure_7": _Figure("Angles of the pendulum", ("α (rad)", "β (rad)", "$α_x$ (rad)", "$α_y$ (rad)"), _angles),
    "figure_8": _Figure(
        "Disturbances, true and estimated",
        ("force x (N)", "force y (N)", "force z (N)", "yaw torque (N·m)"),
        lambda t: t.estimate[:, GUST_COLUMNS],
        lambda t: t.disturbance[:, GUST_COLUMNS],
        "true",
    ),
    "figure_9": _Figure(
        "Control signals",
        ("$τ_θ$ (N·m)", "$τ_φ$ (N·m)", "$u$ (N)", "$τ_ψ$ (N·m)"),
        lambda t: t.command[:, _COMMANDS],
    ),
}


def draw(experiment: Experiment, folder: Path) -> None:
    """Write all figures into `folder`."""
    import matplotlib

    # Without a date and with fixed ids, the SVG files are reproducible byte by byte.
    with matplotlib.rc_context({"svg.hashsalt": "quadpend", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figures = {name: _panels(experiment, figure) for name, figure in FIGURES.items()}
        figures["figure_10"] = _trajectory_figure(experiment["continuous"])
        for name, figure in figures.items():
            for ending, options in ((".png", {"dpi": 200}), (".svg", {"metadata": {"Date": None}})):
                figure.savefig(folder / (name + ending), **options)


def _panels(experiment: Experiment, drawn: _Figure) -> Any:
    from matplotlib.figure import Figure

    rows, reference = len(drawn.labels) // 2, experiment["continuous"]
    figure: Any = Figure(figsize=(7.5, 2.3 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for i, (axis, label) in enumerate(zip(axes, drawn.labels, strict=True)):
        for name, trajectory in experiment.items():
            axis.plot(trajectory.time, drawn.values(trajectory)[:, i], linewidth=1.2, label=name, **_STYLES[name])
        if drawn.compared is not None:
            style = {"color": "#000000", "linestyle": drawn.line, "linewidth": 0.8, "label": drawn.name}
            axis.plot(reference.time, drawn.compared(reference)[:, i], **style)
        axis.axvline(GUSTS.onset, color="#888888", linewidth=0.8)
        axis.set_ylabel(f"({'abcd'[i]}) {label}")
    for axis in axes[-2:]:
        axis.set_xlabel("time (s)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"{drawn.title} (gusts from {GUSTS.onset:g} s)", fontsize=10)
    return figure


def _trajectory_figure(trajectory: Trajectory) -> Any:
    """Draw Figure 10: the trajectory in space with one pendulum per second, and its three projections."""
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(8.5, 8.0), layout="constrained")
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
