"""docs/tasks-results/tables.md: how well policies solve the other tasks of the paper's vehicle.

    python -m experiments.tasks --jobs 2      # 200 episodes in each scenario, seeds from 1000000

- swing-up and recovery: how often and how soon episodes settle;
- load (a hanging pendulum) and agile (fast references): the tracking error; agile also over the peak acceleration.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from experiments.pages import CACHE, DOCS, fill, options, with_survival
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_gym.core.arrays import Floats
from quadpend_gym.envs.world import world_of
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.tasks.trajectories import Reference
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.recovery import settling_times
from quadpend_train.evaluation.statistics import Interval, mean, proportion
from quadpend_train.evaluation.table import Cell, cells
from quadpend_train.reports import figures

SOON = 5.0  # s
SETTLING = {
    "settled": "settled (%)",
    "settled_soon": f"within {SOON:g} s (%)",
    "penalised_time": "penalised time (s)",
    "settled_rmse": "RMSE of the second half (mm)",
}
TRACKING = {
    "survival": "survival (%)",
    "penalised_rmse": "penalised RMSE (mm)",
    "settled_rmse": "RMSE of the second half (mm)",
    "largest_tilt": "largest tilt (°)",
}


# Parts of the page: scenarios, the policies, and the metrics of the table with their headings
HUMMINGBIRD = [SCENARIOS[name].with_vehicle("hummingbird", "body_rates") for name in ("swing_up", "swing_up_breeze")]
PARTS: dict[str, tuple[Sequence[str | Scenario], tuple[str, ...], dict[str, str]]] = {
    "swing-up-hummingbird": (HUMMINGBIRD, ("swing-up",), SETTLING),
    "swing-up": (["test-swing-up"], ("swing-up", "ppo-swing-up-wind", "ppo-swing-up", "sac-swing-up"), SETTLING),
    "load": (["test-load"], ("flatness", "dual-mode", "lqi", "lqr", "ppo-load", "sac-load"), TRACKING),
    "recovery": (["test-recovery"], ("swing-up", "ppo-recovery", "sac-recovery"), SETTLING),
    "agile": (["agile"], ("flatness", "dual-mode", "lqr", "adrc-paper", "ppo-agile", "sac-agile"), TRACKING),
}


def settling(found: Comparison, cell: Cell) -> dict[str, Interval]:
    """Return how often and how soon episodes settle; one that has not settled counts with its full duration."""
    scenario = found.scenarios[cell[0]]
    time = settling_times(cells(found.table)[cell]["survived"], found.errors[cell], scenario.simulation.period)
    return {
        "settled": proportion(~np.isnan(time)).scaled(100.0),
        "settled_soon": proportion(time <= SOON).scaled(100.0),
        "penalised_time": mean(np.where(np.isnan(time), scenario.duration, time)).clipped(0.0, scenario.duration),
    }


def table(found: Comparison, columns: dict[str, str]) -> str:
    """Return the metrics of a part as a Markdown table."""
    rows = []
    for cell, summary in found.summaries.items():
        shown = summary | (settling(found, cell) if "settled" in columns else {})
        rows.append([*cell, *(format_interval(shown[name]) for name in columns)])
    return markdown_table(["scenario", "policy", *columns.values()], rows)


ACCELERATIONS = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0)  # m/s²
_LABEL = "peak acceleration of the reference (m/s²)"


def fast(acceleration: float) -> Scenario:
    """Return calm air with references of a peak acceleration."""
    task = SCENARIOS["agile_windy"].task
    references = replace(task.references, acceleration=(acceleration, acceleration))
    return Scenario(task=replace(task, references=references), loop_known=False)


class Feasible(NamedTuple):
    """Shares, from 0 to 1, of references whose feedforward is within the limits of thrust, of torques, of both."""

    thrust: float
    torques: float
    both: float


def feasible_shares(acceleration: float, episodes: int, seed: int) -> Feasible:
    """Return the shares of the references of an acceleration whose feedforward is within the limits of the command.

    The feedforward is computed at 500 points over the duration of an episode. The limits of tilt do not count.
    """
    scenario = fast(acceleration)
    env = scenario.make_vec(episodes, AutoresetMode.DISABLED)
    env.reset(seed=seed)
    references = world_of(env).reference
    scale = scenario.simulation.command_scale
    time = np.linspace(0.0, scenario.duration, 500)
    commands = np.array([feedforward_command(reference, time, scenario) for reference in references])
    within = np.all(np.abs(commands - scale * [1.0, 0.0, 0.0, 0.0]) <= scale, axis=1)
    return Feasible(*(float(np.mean(np.all(within[:, part], axis=1))) for part in np.s_[:1, 1:, :]))


def feedforward_command(reference: Floats, time: Floats, scenario: Scenario) -> Floats:
    """Return the feedforward of the flatness-based controller in calm air: thrust (N) and torques (N·m), shape (k, 4).

    Equations (1) to (5) of `quadpend_baselines.modelling.flat_outputs` are exact on circles. Elsewhere they leave out
    the vertical acceleration of the bob relative to the quadrotor.
    """
    derivatives = Reference.from_array(reference).derivatives(time)
    none = np.zeros((len(time), DISTURBANCE_SIZE))
    model = equivalent_model(scenario.simulation)
    state, command = model.trajectory(derivatives[:, 2:, :3], derivatives[:, :3, 3], none)
    return model.body_command(state, command, none)


def acceleration_table(found: Comparison, feasible: Sequence[Feasible]) -> str:
    """Return the penalised RMSE over the acceleration as Markdown, with the survival where it is below 100 %."""
    rows = []
    for name, shares in zip(found.scenarios, feasible, strict=True):
        summaries = [found.summaries[name, policy] for policy in found.policies]
        flights = [with_survival(format_interval(summary["penalised_rmse"]), summary) for summary in summaries]
        rows.append([name, *(f"{100.0 * share:.0f}" for share in shares), *flights])
    headings = [_LABEL, "thrust within limits (%)", "torques within limits (%)", "both (%)"]
    return markdown_table([*headings, *found.policies], rows)


def acceleration_figure(found: Comparison, feasible: Sequence[Feasible]) -> Any:
    """Return a figure of survival and penalised RMSE over the acceleration, beside what the limits permit."""
    figure = figures.new_figure(7.5, 5.2)
    (survival,), (rmse,) = figures.add_axes(figure, 2, 1, sharex=True)
    curves = {policy: [found.summaries[name, policy] for name in found.scenarios] for policy in found.policies}
    for i, curve in enumerate(curves.values()):
        for part, metric in ((survival, "survival"), (rmse, "penalised_rmse")):
            middle, low, high = np.array([point[metric] for point in curve]).T
            figures.draw_curve(part, i, ACCELERATIONS, low, middle, high)
        rmse.plot(ACCELERATIONS, middle, ".", color=figures.colour(i), markersize=4)
    values = np.array([summary["penalised_rmse"] for summary in found.summaries.values()])
    figures.set_log_scale(rmse, float(values[values > 0.0].min()), float(values.max()))
    for name, line in (("thrust", "--"), ("torques", "-.")):
        shares = [100.0 * getattr(item, name) for item in feasible]
        label = f"references with {name} within limits"
        survival.plot(ACCELERATIONS, shares, color="#777777", linestyle=line, label=label)
    survival.set_ylabel("survival, share of references (%)", fontsize=8)
    survival.set(ylim=(-3.0, 103.0), xlim=(ACCELERATIONS[0], ACCELERATIONS[-1]))
    rmse.set(ylabel="penalised RMSE (mm)", xlabel=_LABEL)
    for part in (survival, rmse):
        part.grid(alpha=0.25)
    survival.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    figures.add_legend(figure, found.policies)
    return figure


def main() -> None:
    """Evaluate all parts, and fill the page."""
    given = options(__doc__, 200)
    for name, (scenarios, policies, columns) in PARTS.items():
        found = compare(policies, scenarios, given.episodes, given.seed, CACHE, jobs=given.jobs)
        text = table(found, columns)
        if name == "agile":
            faster = {f"{value:g}": fast(value) for value in ACCELERATIONS}
            found = compare(policies, faster, given.episodes, given.seed, CACHE, jobs=given.jobs)
            feasible = [feasible_shares(value, given.episodes, given.seed) for value in ACCELERATIONS]
            text += "\n\n" + acceleration_table(found, feasible)
            figures.write_png(acceleration_figure(found, feasible), DOCS / "tasks-results/agile.png")
        fill(DOCS / "tasks-results/tables.md", {f"tasks-{name}": text})


if __name__ == "__main__":
    main()
