"""docs/vehicles-results/tables.md: how well controllers fly real vehicles.

    python -m experiments.vehicles --jobs 2      # 100 episodes in each scenario, seeds from 1000000

The page has three parts:

- presets: every vehicle on random references, in calm air and in a fluctuating force whose root mean square is a tenth
  of the weight; a rigid vehicle is commanded by body rates;
- recovery: the largest tilt, and the largest tilt rate of an upright pole, from which a controller returns to hover in
  calm air, as it does from all smaller ones;
- as-flown: the scenarios of the set `as-flown`, with controllers that predict over the latency, and without.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from experiments.pages import CACHE, DOCS, fill, options, with_survival
from quadpend_baselines import CONTROLLERS
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import SETS, Scenario
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.measures import settling_times
from quadpend_train.policies.loading import load_policies

WIND_SHARE = 0.1  # root mean square of the force of the wind, as a share of the weight
FLYERS = ("flatness", "lqi", "lqr", "adrc-matched")
TILTS, RATES = np.arange(60.0), np.arange(0.0, 300.0, 5.0)  # °, °/s
# Starts at hover with growing tilts and growing tilt rates, rad and rad/s
START_LINES = {
    "tilt": (np.radians(TILTS), np.zeros_like(TILTS)),
    "tilt_rate": (np.zeros_like(RATES), np.radians(RATES)),
}


def calm_scenario(vehicle: str) -> Scenario:
    """Return random references in calm air with a vehicle of `VEHICLES`, commanded by body rates if it is rigid."""
    rigid = VEHICLES[vehicle].attitude == "rigid"
    return Scenario(vehicle=VEHICLES[vehicle], interface="body_rates" if rigid else "wrench")


def windy_scenario(vehicle: str) -> Scenario:
    """Return `calm_scenario` in a fluctuating force with a root mean square of `WIND_SHARE` of the weight."""
    force = WIND_SHARE * VEHICLES[vehicle].weight / np.sqrt(3.0)
    return replace(calm_scenario(vehicle), wind=OrnsteinUhlenbeck(force=float(force)))


def presets(policies: Sequence[str], vehicles: Sequence[str], episodes: int, seed: int, jobs: int) -> str:
    """Return the penalised RMSE on vehicles in calm air and in wind, as a Markdown table."""
    made = {"calm air": calm_scenario, "wind": windy_scenario}
    scenarios = {f"{vehicle}, {air}": scenario(vehicle) for vehicle in vehicles for air, scenario in made.items()}
    found = compare(policies, scenarios, episodes, seed, CACHE, jobs=jobs)
    rows = [[*name.split(", "), *(_error(found, name, policy) for policy in policies)] for name in scenarios]
    return markdown_table(["vehicle", "air", *policies], rows)


def starts(tilt: Floats, rate: Floats) -> dict[str, Any]:
    """Return the options of `reset` for hover with a pole that is tilted and turns in the x-z plane, shapes (n,)."""
    x, z, none = np.sin(tilt), np.cos(tilt), np.zeros_like(tilt)
    state: dict[str, Any] = dict.fromkeys(("velocity", "euler", "euler_rate"), (0.0, 0.0, 0.0))
    state |= {"position": (0.0, 0.0, 2.0), "direction": np.column_stack([x, none, z])}
    return {"state": state | {"direction_rate": np.column_stack([rate * z, none, -rate * x])}}


def largest_recovered(times: Floats, values: Floats) -> float:
    """Return the largest of ascending values up to which all settling times, shape (s, n), exist; nan if none."""
    fails = np.isnan(times).any(axis=0)
    count = int(fails.argmax()) if fails.any() else values.size
    return float(values[count - 1]) if count else np.nan


def recovery(policies: Sequence[str], vehicles: Sequence[str], seed: int, jobs: int) -> str:
    """Return the largest tilts and tilt rates from which controllers recover, as a Markdown table."""
    hover = {vehicle: replace(calm_scenario(vehicle), task=TASKS["hover"]) for vehicle in vehicles}
    learners = {name: load_policies(name) for name in policies}
    flights = {
        (line, vehicle, policy): Job(learner, hover[vehicle], len(given[0]), seed, starts(*given))
        for line, given in START_LINES.items()
        for vehicle in vehicles
        for policy, learner in learners.items()
    }
    results = run_jobs(flights, CACHE, processes=jobs)

    def cell(line: str, vehicle: str, policy: str) -> str:
        found, values = results[line, vehicle, policy], TILTS if line == "tilt" else RATES
        value = largest_recovered(settling_times(found.survived, found.error, hover[vehicle].period), values)
        return "–" if np.isnan(value) else f"{'≥ ' if value == values[-1] else ''}{value:.0f}"

    rows = [
        [vehicle, *(" / ".join(cell(line, vehicle, policy) for line in START_LINES) for policy in policies)]
        for vehicle in vehicles
    ]
    return markdown_table(["tilt (°) / tilt rate (°/s)", *policies], rows)


def as_flown(policies: Sequence[str], episodes: int, seed: int, jobs: int) -> str:
    """Return the settled RMSE of controllers in the set as-flown, also without prediction, as a Markdown table."""
    names = [name for policy in policies for name in (policy, f"{policy}-unpredicted") if name in CONTROLLERS]
    found = compare(names, ["as-flown"], episodes, seed, CACHE, jobs=jobs)
    members = SETS["as-flown"]
    rows = [[name, *(_error(found, member, name, "settled_rmse") for member in members)] for name in names]
    return markdown_table(["controller", *members], rows)


def _error(found: Comparison, scenario: str, policy: str, error: str = "penalised_rmse") -> str:
    summary = found.summaries[scenario, policy]
    return with_survival(format_number(summary[error].value), summary)


def main() -> None:
    """Measure all parts and fill the page."""
    given = options(__doc__, 100)
    run = given.episodes, given.seed
    parts = {
        "presets": presets(FLYERS, tuple(VEHICLES), *run, given.jobs),
        "recovery": recovery(FLYERS, tuple(VEHICLES), given.seed, given.jobs),
        "as-flown": as_flown(FLYERS, 2 * given.episodes, given.seed, given.jobs),
    }
    fill(DOCS / "vehicles-results/tables.md", {f"vehicles-{name}": table for name, table in parts.items()})


if __name__ == "__main__":
    main()
