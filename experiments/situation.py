"""Part of docs/results/tables.md: what `apg` gains from observing its own situation instead of the mean one.

    python -m experiments.situation --jobs 2      # 200 episodes in each scenario, seeds from 1000000

A policy that observes the situation (`quadpend_baselines.hybrid.situation`) can act differently in noise, wind and calm
air. Here it is compared, in the same episodes, with the same network that observes the mean situation instead: at each
step of an episode the mean over its training scenarios at that step. (In the first second the situation depends on the
time, because the observer is still settling.) So the difference is what the network makes of the scenario's own
situation. It is not what a network would lose that has been trained without the situation.
"""

from copy import copy
from typing import Any

import numpy as np

from experiments.pages import CACHE, DOCS, fill, interval_figure, made_by, options
from quadpend_baselines.hybrid import EstimateOnly, HybridMemory
from quadpend_baselines.hybrid.situation import SITUATION_SIZE, situation_inputs
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import find_scenarios
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.statistics import Interval, mean, paired_proportion
from quadpend_train.evaluation.table import cells
from quadpend_train.policies.loading import load_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.reports import figures
from quadpend_train.training.environment import concatenate_scenarios

POLICY = "apg"
SCENARIOS = ("uncertain", "lagged", "noisy", "dryden_severe", "upset")
EPISODES_OF_MEAN = 32  # of each training scenario


def mean_situation(policy: MlpPolicy) -> Floats32:
    """Return the mean situation at each step of an episode, shape (steps, 12), over the policy's training scenarios."""
    scenarios = [*find_scenarios(policy.card["settings"]["scenarios"]).values()]
    env = concatenate_scenarios(scenarios, EPISODES_OF_MEAN * len(scenarios))
    seen = [
        situation_inputs(step.memory.hybrid.situation)[step.active].astype(np.float32)
        for step in rollout(policy, env, VALIDATION_SEED)
    ]
    return np.array([rows.mean(axis=0) for rows in seen if len(rows)], np.float32)


class MeanSituation(EstimateOnly):
    """`EstimateOnly` whose policy observes a table of situations, shape (steps, 12), instead of its own."""

    table: Floats32

    def __init__(self, hybrid: EstimateOnly, table: Floats32) -> None:
        super().__init__(hybrid.base_controller, situation=True)
        object.__setattr__(self, "table", table)  # the settings of a hybrid are frozen

    def observe(self, observation: Any, memory: HybridMemory | None, episode_start: Any) -> tuple[Any, HybridMemory]:
        """Return the policy's observation with the situation of the table, and the memory."""
        seen, memory = super().observe(observation, memory, episode_start)
        steps = np.minimum(memory.situation.steps.astype(int), len(self.table)) - 1
        seen[:, -SITUATION_SIZE:] = self.table[steps]
        return seen, memory


def with_mean_situation(policy: Any) -> MlpPolicy:
    """Return a policy that observes the mean situation of its training scenarios."""
    other: MlpPolicy = copy(policy)
    assert isinstance(policy.hybrid, EstimateOnly)
    other.hybrid = MeanSituation(policy.hybrid, mean_situation(policy))
    return other


def measure(episodes: int, seed: int, jobs: int) -> dict[str, dict[str, Interval]]:
    """Return the penalised RMSE of both policies and their differences, by scenario and heading of the table."""
    held: Any = [with_mean_situation(policy) for policy in load_policies(POLICY)]
    own = compare([POLICY], SCENARIOS, episodes, seed, CACHE, jobs=jobs)
    constant = compare({POLICY: held}, SCENARIOS, episodes, seed)
    values, others = cells(own.table), cells(constant.table)
    out: dict[str, dict[str, Interval]] = {}
    for cell in values:
        own_values, other = values[cell], others[cell]
        both = own_values["survived"] & other["survived"]
        survivors = np.where(both, own_values["rmse"] - other["rmse"], np.nan)
        out[cell[0]] = {
            "adaptive (mm)": own.summaries[cell]["penalised_rmse"],
            "mean situation (mm)": constant.summaries[cell]["penalised_rmse"],
            "difference (mm)": mean(own_values["penalised_rmse"] - other["penalised_rmse"]).scaled(1000.0),
            "where both survive (mm)": mean(survivors).scaled(1000.0),
            "survival (points)": paired_proportion(own_values["survived"], other["survived"]).scaled(100.0),
        }
    return out


def main() -> None:
    """Measure, and write the folder and the part of the page."""
    given = options(__doc__, 200)
    measured = measure(given.episodes, given.seed, given.jobs)
    shown = {
        "all episodes, a fall counts as 1 m": "difference (mm)",
        "episodes that both survive": "where both survive (mm)",
    }
    drawn = {scenario: {label: row[key] for label, key in shown.items()} for scenario, row in measured.items()}
    label = "RMSE with the own situation minus RMSE with the mean situation (mm)"
    figures.write_png(interval_figure(drawn, label), DOCS / "situation/situation.png")
    rows = [[scenario, *map(format_interval, row.values())] for scenario, row in measured.items()]
    table = markdown_table(["scenario", *next(iter(measured.values()))], rows)
    fill(DOCS / "results/tables.md", {"situation": f"{made_by('situation', given.episodes, given.seed)}\n\n{table}"})


if __name__ == "__main__":
    main()
