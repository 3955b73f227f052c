"""docs/results/sample.csv and docs/flight/sample.csv: episodes of the published tables, which a test flies again.

    python -m experiments.samples      # three episodes of each policy in each scenario, seeds from 1000000; 4 minutes

Processors round differently, and some flights amplify that. So each episode is flown twice, the second time from a
start that is 1 nm away. ``moved`` is the largest relative change that this causes in the values of the episode. An
episode is left out if its survival changes, and its values are left out if their tolerance would exceed `LARGEST`.
"""

from typing import Any

import pandas as pd

from experiments import flight, results
from experiments.pages import DOCS, training_seeds
from quadpend_gym.scenarios import find_scenario, find_scenarios
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.episodes import TEST_SEED, run_episodes
from quadpend_train.policies.loading import load_policies

PAGES = {"results": ((*results.LEARNED, *results.CLASSICAL), "test"), "flight": (flight.POLICIES, "flight")}
EPISODES, MOVE = 3, 1e-9  # m, the distance of the two starts
ROUNDING, AMPLIFICATION, LARGEST = 1e-6, 300.0, 0.01  # relative tolerance: the sum of two parts, and its upper limit
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
    """Return the largest relative difference of the values of each episode; nan where there are none."""
    return (other[VALUES] / table[VALUES] - 1.0).abs().max(axis=1)


def tolerance(moved: pd.Series) -> pd.Series:
    """Return the largest relative difference that the rounding of a processor may cause in the values of episodes."""
    return ROUNDING + AMPLIFICATION * moved


def sample(policy: str, scenario: str) -> pd.DataFrame:
    """Return the rows of a policy in a scenario."""
    table, other = fly(policy, scenario), fly(policy, scenario, MOVE)
    moved = change(table, other)
    table[VALUES] = table[VALUES].where(tolerance(moved) <= LARGEST)
    table = table.assign(scenario=scenario, policy=policy, episode=table.index, moved=moved)
    table = table[["scenario", "policy", "episode", "survived", "moved", *VALUES]]
    return table[table["survived"] == other["survived"]]


def main() -> None:
    """Fly, and write both files."""
    for page, (policies, scenarios) in PAGES.items():
        table = pd.concat(sample(p, s) for s in find_scenarios([scenarios]) for p in policies)
        write_text(DOCS / page / "sample.csv", table.to_csv(index=False, lineterminator="\n"))


if __name__ == "__main__":
    main()
