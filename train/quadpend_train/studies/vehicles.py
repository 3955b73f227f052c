"""How well controllers fly real vehicles: with and without wind, from large tilts, and in the flights of an experiment.

The study has three parts, each a table of Markdown:

- ``presets``: every vehicle of `quadpend_gym.vehicles.VEHICLES` on random references, in calm air and in a fluctuating
  force whose root mean square is `WIND_SHARE` of the weight;
- ``recovery``: the largest tilt, and the largest tilt rate of an upright pole, from which a controller returns to hover
  in calm air, as it does from all smaller ones (`quadpend_train.studies.recovery` defines a recovery);
- ``as-flown``: the scenarios of the set `as-flown`, with controllers that predict over the latency, and without.

A rigid vehicle is commanded by body rates. Every controller knows the nominal vehicle, its interface and its latency.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import CONTROLLERS
from quadpend_baselines.gains import UNPREDICTED
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import SCENARIOS, SETS, Scenario
from quadpend_gym.tasks import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.common.files import to_json_data
from quadpend_train.evaluation.comparison import summarise
from quadpend_train.evaluation.episodes import EpisodeResults
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.studies.recovery import START_LINES, StartGrid, classify_recovery, largest_recovered

WIND_SHARE = 0.1  # root mean square of the force of the wind, as a share of the weight
_SEPARATOR = " · "


class Table(NamedTuple):
    """A table of the study.

    Attributes:
        markdown: The table as Markdown.
        data: Its numbers as data for JSON.
    """

    markdown: str
    data: dict[str, Any]


def vehicle_scenario(vehicle: str) -> Scenario:
    """Return random references in calm air with a vehicle of `VEHICLES`, commanded by body rates if it is rigid."""
    rigid = VEHICLES[vehicle].attitude == "rigid"
    return Scenario(vehicle=VEHICLES[vehicle], interface="body_rates" if rigid else "wrench")


def windy_scenario(vehicle: str) -> Scenario:
    """Return `vehicle_scenario` in a fluctuating force with a root mean square of `WIND_SHARE` of the weight."""
    force = WIND_SHARE * VEHICLES[vehicle].weight / np.sqrt(3.0)
    return replace(vehicle_scenario(vehicle), wind=OrnsteinUhlenbeck(force=float(force)))


def measure_presets(
    policies: Sequence[str], vehicles: Sequence[str], episodes: int, seed: int, **settings: Any
) -> Table:
    """Evaluate controllers on vehicles in calm air and in wind.

    Args:
        policies: Names of controllers.
        vehicles: Keys of `VEHICLES`.
        episodes: Number of episodes of each vehicle and wind.
        seed: Seed of the first episode.
        settings: Further arguments of `run_jobs`.
    """
    made = {"calm air": vehicle_scenario, "wind": windy_scenario}
    jobs = {
        (air, vehicle, policy): Job(policy, scenario(vehicle), episodes, seed)
        for vehicle in vehicles
        for policy in policies
        for air, scenario in made.items()
    }
    results = run_jobs(jobs, **settings)
    rows = [
        [vehicle, air, *(_flight(results[air, vehicle, policy]) for policy in policies)]
        for vehicle in vehicles
        for air in made
    ]
    return Table(markdown_table(["vehicle", "air", *policies], rows), _data(results))


def measure_recovery(policies: Sequence[str], vehicles: Sequence[str], seed: int, **settings: Any) -> Table:
    """Find the largest tilt and tilt rate from which each controller recovers on each vehicle.

    Args:
        policies: Names of controllers.
        vehicles: Keys of `VEHICLES`.
        seed: Seed of the first episode, on which only the random numbers of a controller depend.
        settings: Further arguments of `run_jobs`.
    """
    jobs = {
        (line, vehicle, policy): Job(
            policy, replace(vehicle_scenario(vehicle), task=TASKS["hover"]), grid.size, seed, grid.options()
        )
        for line, grid in START_LINES.items()
        for vehicle in vehicles
        for policy in policies
    }
    results = run_jobs(jobs, **settings)
    largest = {}
    for (line, vehicle, policy), found in results.items():
        outcomes = classify_recovery(found, START_LINES[line], jobs[line, vehicle, policy].scenario.simulation.period)
        largest[line, vehicle, policy] = largest_recovered(outcomes, _grown(START_LINES[line]))
    rows = [
        [
            vehicle,
            *(" / ".join(_angle(largest[line, vehicle, policy], line) for line in START_LINES) for policy in policies),
        ]
        for vehicle in vehicles
    ]
    data = {_SEPARATOR.join(key): None if np.isnan(value) else value for key, value in largest.items()}
    return Table(markdown_table(["tilt (°) / tilt rate (°/s)", *policies], rows), data)


def measure_as_flown(policies: Sequence[str], episodes: int, seed: int, **settings: Any) -> Table:
    """Evaluate controllers in the scenarios of `as-flown`, each also without its prediction if there is such a one.

    Args:
        policies: Names of controllers.
        episodes: Number of episodes of each scenario.
        seed: Seed of the first episode.
        settings: Further arguments of `run_jobs`.
    """
    members = SETS["as-flown"]
    names = [name for policy in policies for name in (policy, policy + UNPREDICTED) if name in CONTROLLERS]
    jobs = {(member, name): Job(name, SCENARIOS[member], episodes, seed) for member in members for name in names}
    results = run_jobs(jobs, **settings)
    rows = [[name, *(_flight(results[member, name], "settled_rmse") for member in members)] for name in names]
    return Table(markdown_table(["controller", *members], rows), _data(results))


def _flight(results: EpisodeResults, error: str = "penalised_rmse") -> str:
    """Return an error in mm, after the survival if that is below 100 %."""
    summary = summarise(results)
    value, survival = summary[error].value, summary["survival"].value
    number = format_number(value)
    return number if survival == 100.0 else f"{number} ({survival:.3g} %)"


def _grown(grid: StartGrid) -> Floats:
    """Return the values of the quantity that grows along one of `START_LINES`."""
    return grid.x.values if grid.x.values.size > 1 else grid.y.values


def _angle(value: float, line: str) -> str:
    last = _grown(START_LINES[line])[-1]
    return "–" if np.isnan(value) else f"{'≥ ' if value == last else ''}{np.degrees(value):.0f}"


def _data(results: Mapping[Any, EpisodeResults]) -> dict[str, Any]:
    return {
        _SEPARATOR.join(key): {name: to_json_data(interval) for name, interval in summarise(found).items()}
        for key, found in results.items()
    }
