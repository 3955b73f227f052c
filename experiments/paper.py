"""docs/paper/merit.json, and Figures 4 to 10 of the paper in results/paper/, from the results of `paper_experiment`.

python -m experiments.paper
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

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


def _angles(trajectory: Trajectory) -> Floats:
    state = State(trajectory.state)
    return np.stack([state.alpha, np.unwrap(state.beta), state.alpha_x, state.alpha_y], axis=1)


# The labels of the panels, the values that they show, and those in black with which these are compared
FIGURES: dict[str, tuple[str, Callable[[Trajectory], Floats], Callable[[Trajectory], Floats] | None]] = {
    "figure_4": ("$F_x$ (m), $F_y$ (m), $z$ (m), ψ (rad)", lambda t: t.outputs, lambda t: t.reference[:, 0]),
    "figure_5": ("pitch θ (rad), roll φ (rad)", lambda t: State(t.state).euler[:, [1, 0]], None),
    "figure_6": ("$e_{Fx}$ (m), $e_{Fy}$ (m), $e_z$ (m), $e_ψ$ (rad)", lambda t: t.error, None),
    "figure_7": ("α (rad), β (rad), $α_x$ (rad), $α_y$ (rad)", _angles, None),
    "figure_8": (
        "force x (N), force y (N), force z (N), yaw torque (N·m)",
        lambda t: t.estimate[:, GUST_COLUMNS],
        lambda t: t.disturbance[:, GUST_COLUMNS],
    ),
    "figure_9": ("$τ_θ$ (N·m), $τ_φ$ (N·m), $u$ (N), $τ_ψ$ (N·m)", lambda t: t.command[:, _COMMANDS], None),
}


def draw(experiment: dict[str, Trajectory], folder: Path) -> None:
    """Write all figures into `folder`."""
    for name, (labels, values, compared) in FIGURES.items():
        figure = figures.new_figure(7.5, 5.1)
        panels = labels.split(", ")
        axes = figures.add_axes(figure, len(panels) // 2, 2, sharex=True).ravel()
        for i, (axis, label) in enumerate(zip(axes, panels, strict=True)):
            for run_name, trajectory in experiment.items():
                axis.plot(trajectory.time, values(trajectory)[:, i], label=run_name, **_STYLES[run_name])
            if compared is not None:
                axis.plot(trajectory.time, compared(trajectory)[:, i], "k-.", linewidth=0.8, label="wanted or true")
            axis.axvline(GUSTS.onset, color="#888888", linewidth=0.8)
            axis.set(xlabel="time (s)", ylabel=label)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
        figures.write_png(figure, folder / f"{name}.png")
    figures.write_png(_trajectory_figure(experiment["continuous"]), folder / "figure_10.png")


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
    argparse.ArgumentParser(prog="python -m experiments.paper", description=__doc__).parse_args()
    results, folder = run(), Path("results/paper")
    folder.mkdir(parents=True, exist_ok=True)
    draw(results, folder)
    merit = {name: figures_of_merit(trajectory) for name, trajectory in results.items()}
    write_text(DOCS / "paper/merit.json", json.dumps(merit, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
