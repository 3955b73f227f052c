"""What observing the situation is worth: policies compared with themselves while the situation is the mean one.

A policy that observes the situation (`quadpend_baselines.hybrid.situation`) can act differently in noise, wind and calm
air. Here it is compared, in the same episodes, with the same network that observes the mean situation instead: at each
step of an episode the mean over its training scenarios at that step. (In the first second the situation depends on the
time, because the observer is still settling.) So the difference is what the network makes of the scenario's own
situation. It is not what a network would lose that has been trained without the situation.
"""

import json
from collections.abc import Mapping
from concurrent.futures import Executor
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_baselines.hybrid import EstimateOnly, HybridMemory
from quadpend_baselines.hybrid.situation import SITUATION_SIZE
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import expand_sets, find_scenario
from quadpend_train.common.files import to_json_data, write_text
from quadpend_train.evaluation.cache import Folder
from quadpend_train.evaluation.comparison import compare, differences
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.policies.loading import load_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.environment import concatenate_scenarios

EPISODES_OF_MEAN = 32  # of each training scenario
LABEL = "RMSE with the own situation minus RMSE with the mean situation (mm)"
_HELD = "mean situation"


def adaptive_policies(name: str) -> list[MlpPolicy]:
    """Return the policies (training seeds) with a name, see `load_policies`.

    Raises:
        ValueError: If one of them does not observe the situation.
    """
    adaptive = []
    for policy in load_policies(name):
        hybrid = policy.hybrid if isinstance(policy, MlpPolicy) else None
        if not isinstance(policy, MlpPolicy) or not isinstance(hybrid, EstimateOnly) or not hybrid.situation:
            raise ValueError(f"{name} does not observe the situation: train with hybrid.situation = true")
        adaptive.append(policy)
    return adaptive


def mean_situation(policy: MlpPolicy) -> Floats32:
    """Return the mean situation at each step of an episode, shape (steps, 12), over the policy's training scenarios."""
    names = expand_sets(policy.card["settings"]["scenarios"])
    env = concatenate_scenarios([find_scenario(name) for name in names], EPISODES_OF_MEAN * len(names))
    seen = [
        step.memory.observations[step.active, -1, -SITUATION_SIZE:] for step in rollout(policy, env, VALIDATION_SEED)
    ]
    return np.array([rows.mean(axis=0) for rows in seen if len(rows)], np.float32)


class MeanSituation(EstimateOnly):
    """`EstimateOnly` whose policy observes a table of situations instead of its own.

    Args:
        hybrid: The hybrid whose base controller it has.
        table: Situation at each step of an episode, shape (steps, 12); the last one counts for all later steps.
    """

    table: Floats32

    def __init__(self, hybrid: EstimateOnly, table: Floats32) -> None:
        """Take the base controller of the hybrid."""
        super().__init__(hybrid.base_controller, situation=True)
        object.__setattr__(self, "table", table)  # the settings of a hybrid are frozen

    def observe(self, observation: Any, memory: HybridMemory | None, episode_start: Any) -> tuple[Any, HybridMemory]:
        """Return the policy's observation with the situation of the table, and the memory."""
        seen, memory = super().observe(observation, memory, episode_start)
        steps = np.minimum(memory.situation.steps.astype(int), len(self.table)) - 1
        seen[:, -SITUATION_SIZE:] = self.table[steps]
        return seen, memory


def with_mean_situation(policy: MlpPolicy) -> MlpPolicy:
    """Return a policy that observes the mean situation of its training scenarios, see `mean_situation`."""
    other, hybrid = copy(policy), policy.hybrid
    assert isinstance(hybrid, EstimateOnly)
    other.hybrid = MeanSituation(hybrid, mean_situation(policy))
    return other


def measure(
    name: str, scenarios: Mapping[str, Any], episodes: int, seed: int, cache: Folder | None, jobs: int | Executor
) -> dict[str, dict[str, Interval]]:
    """Return the metrics of the policy, of the policy with the mean situation, and their differences, by scenario.

    Args:
        name: Name of the policy, see `load_policies`.
        scenarios: Scenarios by name, as for `compare`.
        episodes: Number of episodes in each scenario.
        seed: Seed of the first episode.
        cache: Folder of cached results of the policy.
        jobs: Number of processes, or an executor.
    """
    policies = adaptive_policies(name)
    held: Any = [with_mean_situation(policy) for policy in policies]
    adaptive = compare({name: name}, scenarios, episodes, seed, cache, jobs=jobs)
    constant = compare({_HELD: held}, scenarios, episodes, seed)
    out = {}
    for scenario in adaptive.scenarios:
        results, other = adaptive.results[scenario, name], constant.results[scenario, _HELD]
        difference = differences(results, other)
        out[scenario] = {
            "adaptive": adaptive.summaries[scenario, name]["penalised_rmse"],
            "held": constant.summaries[scenario, _HELD]["penalised_rmse"],
            "penalised_rmse": difference["penalised_rmse"],
            "rmse": difference["rmse_of_survivors"],
            "survival": difference["survival"],
        }
    return out


def markdown(measured: Mapping[str, Mapping[str, Interval]]) -> str:
    """Return a Markdown table with a line for each scenario."""
    headings = ["scenario", "adaptive (mm)", "mean situation (mm)"]
    headings += ["difference (mm)", "where both survive (mm)", "survival (points)"]
    rows = [[scenario, *(format_interval(value) for value in row.values())] for scenario, row in measured.items()]
    return markdown_table(headings, rows)


def gains(measured: Mapping[str, Mapping[str, Interval]]) -> dict[str, dict[str, Interval]]:
    """Return the differences for the figure, in mm, by scenario; their axis has the label `LABEL`."""
    shown = {"all episodes, a fall counts as 1 m": "penalised_rmse", "episodes that both survive": "rmse"}
    return {scenario: {label: row[key] for label, key in shown.items()} for scenario, row in measured.items()}


def save(measured: Mapping[str, Mapping[str, Interval]], provenance: Mapping[str, Any], path: Path) -> None:
    """Write the numbers as JSON: penalised RMSE and differences in mm, survival in percentage points."""
    data = {"provenance": provenance, "results": to_json_data(measured)}
    write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")
