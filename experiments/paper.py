"""docs/paper/merit.json, and Figures 4 to 10 of the paper in results/paper/, from the results of `paper_experiment`.

python -m experiments.paper
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.pages import DOCS
from experiments.paper_continuous import Trajectory
from experiments.paper_experiment import GUST_COLUMNS, GUSTS, RECORDING_PERIOD, figures_of_merit, run
from quadpend_gym import PAPER, State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_TORQUE, THRUST
from quadpend_train.common.files import write_text
from quadpend_train.reports import figures

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


def draw(experiment: dict[str, Trajectory], folder: Path) -> None:
    """Write all figures into `folder`."""
    for name, figure in FIGURES.items():
        figures.write_png(_panels(experiment, figure), folder / f"{name}.png")
    figures.write_png(_trajectory_figure(experiment["continuous"]), folder / "figure_10.png")


def _panels(experiment: dict[str, Trajectory], drawn: _Figure) -> Any:
    rows, reference = len(drawn.labels) // 2, experiment["continuous"]
    figure = figures.new_figure(7.5, 2.3 * rows + 0.5)
    axes = figures.add_axes(figure, rows, 2, sharex=True).ravel()
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
    figure = figures.new_figure(8.5, 8.0)
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


def main() -> None:
    """Simulate, and write the figures and the figures of merit."""
    results, folder = run(), Path("results/paper")
    folder.mkdir(parents=True, exist_ok=True)
    draw(results, folder)
    merit = {name: figures_of_merit(trajectory) for name, trajectory in results.items()}
    write_text(DOCS / "paper/merit.json", json.dumps(merit, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
