"""docs/vehicles-results.md: how well controllers fly real vehicles.

    python -m experiments.vehicles --jobs 2      # 100 episodes in each scenario, seeds from 1000000

The page has four parts:

- presets: every vehicle on random references, in calm air and in a fluctuating force whose root mean square is a tenth
  of the weight; a rigid vehicle is commanded by body rates;
- recovery: the largest tilt, and the largest tilt rate of an upright pole, from which a controller returns to hover in
  calm air, as it does from all smaller ones;
- as-flown: the scenarios of the set `as-flown`, with controllers that predict over the latency, and without;
- leaderboard: the set `test-hummingbird`, with learned policies.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.pages import CACHE, DOCS, fill, options, with_survival
from experiments.recovery import START_LINES, StartGrid, largest_recovered, recovery_map
from experiments.results import matrix
from quadpend_baselines import CONTROLLERS
from quadpend_baselines.gains import UNPREDICTED
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import SETS, Scenario
from quadpend_gym.tasks.task import TASKS
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.policies.loading import load_policies
from quadpend_train.reports.tables import leaderboard_markdown

WIND_SHARE = 0.1  # root mean square of the force of the wind, as a share of the weight
FLYERS = ("flatness", "lqi", "lqr", "adrc-matched")
LEARNED = ("ppo-hummingbird", "sac-hummingbird")


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


def recovery(policies: Sequence[str], vehicles: Sequence[str], seed: int, jobs: int) -> str:
    """Return the largest tilts and tilt rates from which controllers recover, as a Markdown table."""
    hover = {vehicle: replace(calm_scenario(vehicle), task=TASKS["hover"]) for vehicle in vehicles}
    learners = {name: load_policies(name) for name in policies}
    flights = {
        (line, vehicle, policy): Job(learner, hover[vehicle], grid.size, seed, grid.options())
        for line, grid in START_LINES.items()
        for vehicle in vehicles
        for policy, learner in learners.items()
    }
    results = run_jobs(flights, CACHE, processes=jobs)

    def cell(line: str, vehicle: str, policy: str) -> str:
        grid = START_LINES[line]
        outcomes = recovery_map(results[line, vehicle, policy], grid, hover[vehicle].simulation.period)
        value, last = largest_recovered(outcomes, _grown(grid)), _grown(grid)[-1]
        return "–" if np.isnan(value) else f"{'≥ ' if value == last else ''}{np.degrees(value):.0f}"

    rows = [
        [vehicle, *(" / ".join(cell(line, vehicle, policy) for line in START_LINES) for policy in policies)]
        for vehicle in vehicles
    ]
    return markdown_table(["tilt (°) / tilt rate (°/s)", *policies], rows)


def _grown(grid: StartGrid) -> Floats:
    """Return the values of the quantity that grows along one of `START_LINES`."""
    return grid.x.values if grid.x.values.size > 1 else grid.y.values


def as_flown(policies: Sequence[str], episodes: int, seed: int, jobs: int) -> str:
    """Return the settled RMSE of controllers in the set as-flown, also without prediction, as a Markdown table."""
    names = [name for policy in policies for name in (policy, policy + UNPREDICTED) if name in CONTROLLERS]
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
    compared = compare((*FLYERS, *LEARNED), ["test-hummingbird"], *run, CACHE, jobs=given.jobs)
    parts = {
        "presets": presets(FLYERS, tuple(VEHICLES), *run, given.jobs),
        "recovery": recovery(FLYERS, tuple(VEHICLES), given.seed, given.jobs),
        "as-flown": as_flown(FLYERS, 2 * given.episodes, given.seed, given.jobs),
        "leaderboard": f"{leaderboard_markdown(leaderboard(compared.table))}\n\n{matrix(compared)}",
    }
    fill(DOCS / "vehicles-results.md", {f"vehicles-{name}": table for name, table in parts.items()})


if __name__ == "__main__":
    main()
