"""docs/results/sample.csv and docs/flight/sample.csv: episodes of the published tables, which a test flies again.

    python -m experiments.samples      # two episodes of each policy in each scenario, seeds from 1000000; 6 minutes

Processors round differently, and some flights amplify that. So each episode is flown again from two more starts, which
are 1 nm further forward or back along each axis. ``moved`` is the largest relative change that this causes in the
values of the episode. An episode is left out if its survival changes, and its values are left out if their tolerance
would exceed `LARGEST`.
"""

import argparse
from typing import Any

import numpy as np
import pandas as pd

from experiments import flight, results
from experiments.pages import DOCS, training_seeds
from quadpend_gym.scenarios import find_scenario, find_scenarios
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policies

PAGES = {
    "results": ((*results.LEARNED, *results.CLASSICAL), ["test"]),
    "flight": (flight.POLICIES, ["flight", "events"]),
}
EPISODES, MOVE = 2, 1e-9  # m, along each axis
# Relative tolerance: the sum of two parts, and its upper limit. Networks have float32 actions, whose rounding moves a
# flight further than `MOVE`: without AVX-512 by up to 300 times `moved`, seen in flight_circle with apg-flight.
ROUNDING, AMPLIFICATION, LARGEST = 1e-6, 1000.0, 0.01
VALUES = ["steps", "rmse", "settled_rmse", "largest_tilt", "effort"]


def fly(policy: str, scenario: str, move: float = 0.0) -> pd.DataFrame:
    """Return survival and values of each episode, of a learner those of the first training seed."""
    env: Any = find_scenario(scenario).make_vec(EPISODES)
    env.reset(seed=TEST_SEED)
    start = {"state": {"position": env.state.position + move}}
    found = run_episodes(
        load_policies(training_seeds(policy).rpartition("=")[2])[:1], scenario, EPISODES, TEST_SEED, start
    )
    return pd.DataFrame({name: getattr(found, name)[0] for name in ("survived", *VALUES)})


def change(table: pd.DataFrame, other: pd.DataFrame) -> pd.Series:
    """Return the largest relative difference of the values of each episode: infinite if only one table has a value."""
    difference = (other[VALUES] / table[VALUES] - 1.0).abs()
    return difference.where(other[VALUES].isna() == table[VALUES].isna(), np.inf).max(axis=1)


def tolerance(moved: pd.Series) -> pd.Series:
    """Return the largest relative difference that the rounding of a processor may cause in the values of episodes."""
    return ROUNDING + AMPLIFICATION * moved


def sample(policy: str, scenario: str) -> pd.DataFrame:
    """Return the rows of a policy in a scenario."""
    table, *others = (fly(policy, scenario, move) for move in (0.0, MOVE, -MOVE))
    moved = pd.concat([change(table, other) for other in others], axis=1).max(axis=1)
    table[VALUES] = table[VALUES].where(tolerance(moved) <= LARGEST)
    table = table.assign(scenario=scenario, policy=policy, episode=table.index, moved=moved)
    table = table[["scenario", "policy", "episode", "survived", "moved", *VALUES]]
    return table[np.all([table["survived"] == other["survived"] for other in others], axis=0)]


def main() -> None:
    """Fly, and write both files."""
    argparse.ArgumentParser(prog="python -m experiments.samples", description=__doc__).parse_args()
    for page, (policies, scenarios) in PAGES.items():
        table = pd.concat(sample(p, s) for s in find_scenarios(scenarios) for p in policies)
        write_text(DOCS / page / "sample.csv", table.to_csv(index=False, lineterminator="\n"))


if __name__ == "__main__":
    main()
