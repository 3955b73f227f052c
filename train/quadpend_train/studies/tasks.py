"""How well policies solve the other tasks of the paper's vehicle: swing-up, hanging load, recovery, fast references.

Each part is a table of Markdown over the scenarios of a set:

- ``swing-up`` and ``recovery``: how often and how soon episodes settle, see `quadpend_train.evaluation.settling`;
- ``load`` and ``agile``: the tracking error.

The part ``agile`` also has curves over the peak acceleration of the reference, see `measure_acceleration`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy
from quadpend_baselines.modelling.equivalent import body_command, reference_trajectory
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_gym.tasks.references import Reference
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.settling import settling_times
from quadpend_train.evaluation.statistics import Interval, mean, proportion
from quadpend_train.studies.perturbations import Fields, PerturbationAxis
from quadpend_train.studies.robustness import CurvePoint, Robustness, measure_robustness

SOON = 5.0  # s
_SETTLING = {
    "settled": "settled (%)",
    "settled_soon": f"within {SOON:g} s (%)",
    "penalised_time": "penalised time (s)",
    "settled_rmse": "RMSE of the second half (mm)",
}
_TRACKING = {
    "survival": "survival (%)",
    "penalised_rmse": "penalised RMSE (mm)",
    "settled_rmse": "RMSE of the second half (mm)",
    "largest_tilt": "largest tilt (°)",
}
_LIMIT_POINTS = 500  # per reference


class Part(NamedTuple):
    """A part of the study.

    Attributes:
        scenarios: Set of scenarios.
        policies: Policies that are compared if none are named.
        columns: Metrics of the table, with their headings.
    """

    scenarios: str
    policies: tuple[str, ...]
    columns: dict[str, str]


PARTS = {
    "swing-up": Part("test-swing-up", ("swing-up", "ppo-swing-up", "sac-swing-up"), _SETTLING),
    "load": Part("test-load", ("flatness", "dual-mode", "mppi", "lqi", "lqr", "ppo-load", "sac-load"), _TRACKING),
    "recovery": Part("test-recovery", ("swing-up", "ppo-recovery", "sac-recovery"), _SETTLING),
    "agile": Part("agile", ("mppi", "flatness", "dual-mode", "lqr", "adrc-paper", "ppo-agile", "sac-agile"), _TRACKING),
}


def settling(results: EpisodeResults, scenario: Scenario) -> dict[str, Interval]:
    """Return how often and how soon episodes settle, with 95 % intervals.

    Returns:
        ``settled`` and ``settled_soon``: shares of episodes that have settled at all, and within `SOON`, %.
        ``penalised_time``: mean settling time, s. An episode that has not settled counts with its full duration.
    """
    time = settling_times(results, scenario.simulation.period)
    return {
        "settled": proportion(~np.isnan(time)).scaled(100.0),
        "settled_soon": proportion(time <= SOON).scaled(100.0),
        "penalised_time": mean(np.where(np.isnan(time), scenario.duration, time)).clipped(0.0, scenario.duration),
    }


def measure(comparison: Comparison, part: str) -> dict[tuple[str, str], dict[str, Interval]]:
    """Return all metrics by scenario and policy, with the settling in the parts whose tables show it."""
    settles = "settled" in PARTS[part].columns
    return {
        (scenario, policy): {
            **comparison.summaries[scenario, policy],
            **(settling(results, comparison.scenarios[scenario]) if settles else {}),
        }
        for (scenario, policy), results in comparison.results.items()
    }


def table(measured: Mapping[tuple[str, str], Mapping[str, Interval]], part: str) -> str:
    """Return the table of a part as Markdown, from what `measure` returns."""
    columns = PARTS[part].columns
    rows = [[*names, *(format_interval(found[name]) for name in columns)] for names, found in measured.items()]
    return markdown_table(["scenario", "policy", *columns.values()], rows)


def _fast_references(acceleration: float, _: Any) -> Fields:
    task = SCENARIOS["agile_windy"].resolved_task
    references = replace(task.references, acceleration=(acceleration, acceleration))
    return {"task": replace(task, references=references)}


ACCELERATION = PerturbationAxis(
    "peak acceleration of the reference",
    "m/s²",
    (1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0),
    _fast_references,
    nominal=1.0,
)


def measure_acceleration(
    policies: Mapping[str, str | Sequence[Policy]], episodes: int, seed: int, **settings: Any
) -> Robustness:
    """Evaluate policies on circles, figure eights and slaloms of increasing peak acceleration in calm air.

    Args:
        policies: Policies by name, as for `measure_robustness`.
        episodes: Number of episodes at each acceleration.
        seed: Seed of the first episode.
        settings: Further arguments of `measure_robustness`.
    """
    return measure_robustness(policies, {"acceleration": ACCELERATION}, {}, episodes, seed, **settings)


class Feasible(NamedTuple):
    """Shares of references whose feedforward is within limits, from 0 to 1.

    Attributes:
        thrust: The limits of the thrust.
        torques: The limits of the torques.
        both: All of these limits.
    """

    thrust: float
    torques: float
    both: float


def feasible_shares(acceleration: float, episodes: int, seed: int) -> Feasible:
    """Return the shares of the references of `ACCELERATION` whose feedforward is within the limits of the command.

    See `feedforward_command`, at 500 points over the duration of an episode. The limits of tilt do not count.

    Args:
        acceleration: Peak acceleration, m/s².
        episodes: Number of references.
        seed: Seed of the first one.
    """
    scenario = ACCELERATION.scenario(acceleration)
    env = scenario.make_vec(episodes, AutoresetMode.DISABLED)
    env.reset(seed=seed)
    references = env.unwrapped.world.reference  # type: ignore[attr-defined]
    scale = scenario.simulation.command_scale
    hover = scale * [1.0, 0.0, 0.0, 0.0]
    time = np.linspace(0.0, scenario.duration, _LIMIT_POINTS)
    commands = np.array([feedforward_command(reference, time, scenario) for reference in references])
    within = np.all(np.abs(commands - hover) <= scale, axis=1)
    return Feasible(*(float(np.mean(np.all(within[:, part], axis=1))) for part in np.s_[:1, 1:, :]))


def feedforward_command(reference: Floats, time: Floats, scenario: Scenario) -> Floats:
    """Return the feedforward of the flatness-based controller in calm air: thrust (N) and torques (N·m), shape (k, 4).

    Equations (1) to (5) of `quadpend_baselines.modelling.flat_outputs` are exact on circles. Elsewhere they leave out
    the vertical acceleration of the bob relative to the quadrotor.

    Args:
        reference: Reference as an array, shape (20,).
        time: Times, s, shape (k,).
        scenario: Scenario with the nominal simulation.
    """
    derivatives = Reference.from_array(reference).derivatives(time)
    none = np.zeros((len(time), DISTURBANCE_SIZE))
    simulation = scenario.simulation
    state, command = reference_trajectory(derivatives[:, 2:, :3], derivatives[:, :3, 3], none, simulation)
    return body_command(state, command, none, simulation)


def acceleration_table(found: Robustness, feasible: Sequence[Feasible]) -> str:
    """Return the penalised RMSE over the acceleration as Markdown, with the survival where it is below 100 %.

    Args:
        found: The result of `measure_acceleration`.
        feasible: `feasible_shares` at the values of `ACCELERATION`.
    """
    curves = [found.curves["acceleration", policy] for policy in found.policies]
    rows = [
        [f"{value:g}", *(f"{100.0 * share:.0f}" for share in shares), *map(_flight, points)]
        for value, shares, *points in zip(ACCELERATION.values, feasible, *curves, strict=True)
    ]
    headings = [ACCELERATION.label, "thrust within limits (%)", "torques within limits (%)", "both (%)"]
    return markdown_table([*headings, *found.policies], rows)


def _flight(point: CurvePoint) -> str:
    """Return the penalised RMSE in mm, followed by the survival in parentheses if that is below 100 %."""
    error = format_interval(point.penalised_rmse.scaled(1000.0))
    return error if point.survival.value == 1.0 else f"{error} ({100.0 * point.survival.value:.3g} %)"
