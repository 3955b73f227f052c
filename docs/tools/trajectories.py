"""Draw the figure of `docs/change-the-environment.md`: ``python -m docs.tools.trajectories``."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines import controller
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import Scenario, find_scenario
from quadpend_gym.tasks.feasibility import demand
from quadpend_train.reports.figures import COLOURS

DOCS = Path(__file__).parents[1]
EXAMPLES = ("square", "lissajous", "ellipse")
SETTLED = 5.0  # s, from where on the path of the bob and its error are shown


def fly(scenario: Scenario) -> Floats:
    """Return the tracking errors of flatness in one episode, m, shape (steps, 3)."""
    env: Any = scenario.make_vec(1, AutoresetMode.DISABLED, max_episode_steps=scenario.steps + 1)
    observation, _ = env.reset(seed=0)
    policy, memory, started, errors = controller("flatness"), None, np.ones(1, np.bool_), []
    for _ in range(scenario.steps):
        action, memory = policy.predict(observation, memory, started)
        observation, *_, info = env.step(action)
        started[:] = False
        errors.append(info["tracking_error"][0])
    return np.array(errors)


def draw(path: Path) -> None:
    """Draw each example from above, the flight of a controller, and the tilt that the trajectory needs."""
    figure, axes = plt.subplots(2, 3, figsize=(10.0, 5.6), height_ratios=(2.2, 1.0), layout="constrained")
    for name, (above, below) in zip(EXAMPLES, axes.T, strict=True):
        scenario: Any = find_scenario(str(DOCS / f"scenarios/{name}.toml"))
        trajectory, errors = scenario.task.trajectory, fly(scenario)
        times = scenario.simulation.period * np.arange(1, scenario.steps + 1)
        x, y = trajectory.derivatives(times)[:, 0, :2].T
        settled = times >= SETTLED
        largest = 1e3 * np.linalg.norm(errors[settled], axis=-1).max()
        above.plot(x, y, color="#bbbbbb", linewidth=4.0, label="reference")
        above.plot(*(np.stack([x, y]) + errors[:, :2].T)[:, settled], color=COLOURS[0], label="flatness, from 5 s on")
        if name == "square":
            above.plot(*np.array(trajectory.points)[:, :2].T, "o", color="black", markersize=4.0, label="waypoints")
        above.set(title=f"{name}: largest error {largest:.2g} mm", xlabel="x (m)", ylabel="y (m)", aspect="equal")
        above.margins(0.08)
        needed = demand(trajectory, scenario.simulation.parameters, times)
        below.plot(times, np.degrees(needed.pendulum_angle), color=COLOURS[1], label="pendulum")
        below.plot(times, np.degrees(needed.body_angle), color=COLOURS[2], linestyle="--", label="body")
        below.set(xlabel="time (s)", ylabel="needed tilt (°)", xlim=(0.0, times[-1]))
        below.set_ylim(bottom=0.0)
    axes[0, 0].legend(loc="center", fontsize="small")
    axes[1, 0].legend(loc="lower right", fontsize="small", ncols=2)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    draw(DOCS / "trajectories.png")
