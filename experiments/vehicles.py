"""docs/vehicles-results/tables.md: how well controllers fly real vehicles.

    python -m experiments.vehicles --jobs 2      # 100 episodes in each scenario, seeds from 1000000

The page has two parts:

- presets: every vehicle on random references, in calm air and in a fluctuating force whose root mean square is a tenth
  of the weight; a rigid vehicle is commanded by body rates;
- as-flown: the scenarios of the set `as-flown`, with controllers that predict over the latency, and without.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.pages import CACHE, DOCS, fill, options, with_survival
from quadpend_baselines import CONTROLLERS
from quadpend_gym.scenarios import SETS, Scenario
from quadpend_gym.vehicles import VEHICLES
from quadpend_gym.wind import OrnsteinUhlenbeck
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_number, markdown_table

WIND_SHARE = 0.1  # root mean square of the force of the wind, as a share of the weight
FLYERS = ("flatness", "lqi", "lqr", "adrc-matched")


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
        "as-flown": as_flown(FLYERS, 2 * given.episodes, given.seed, given.jobs),
    }
    fill(DOCS / "vehicles-results/tables.md", {f"vehicles-{name}": table for name, table in parts.items()})


if __name__ == "__main__":
    main()
