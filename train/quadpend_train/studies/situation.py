"""What adapting is worth: policies that observe the situation, compared with themselves without it.

A policy that observes the situation (`quadpend_baselines.hybrid.situation`) can act differently in noise, wind and calm
air. Here it is compared with the same network whose situation is held at its mean over the training scenarios, in the
same episodes. The difference is what the network gains from telling the situations apart.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_baselines.hybrid.situation import SITUATION_SIZE
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats32
from quadpend_train.common.files import to_json_data
from quadpend_train.evaluation.comparison import compare, differences
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.formatting import format_interval
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.policies.loading import load_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.scenarios import expand_sets, find_scenario
from quadpend_train.training.environment import concatenate_scenarios

EPISODES_OF_MEAN = 32  # of each training scenario
LABEL = "RMSE with the situation minus RMSE with its mean (mm)"
_HELD = "held at its mean"


def adaptive_policies(name: str) -> list[MlpPolicy]:
    """Return the policies (training seeds) with a name, see `load_policies`.

    Raises:
        ValueError: If one of them does not observe the situation.
    """
    policies = load_policies(name)
    for policy in policies:
        if not isinstance(policy, MlpPolicy) or not getattr(policy.hybrid, "situation", False):
            raise ValueError(f"{name} does not observe the situation: train with hybrid.situation = true")
    return policies


def mean_situation(policy: MlpPolicy) -> Floats32:
    """Return the mean situation in validation episodes of the policy's training scenarios, shape (12,)."""
    names = expand_sets(policy.card["settings"]["scenarios"])
    total, count = np.zeros(SITUATION_SIZE), 0
    for name in names:
        env = concatenate_scenarios([find_scenario(name)], EPISODES_OF_MEAN)
        for step in rollout(policy, env, VALIDATION_SEED):
            seen = step.memory.observations[step.active, -1, -SITUATION_SIZE:]
            total, count = total + seen.sum(axis=0), count + len(seen)
    return (total / count).astype(np.float32)


def without_situation(policy: MlpPolicy, held: Floats32) -> MlpPolicy:
    """Return the policy that acts as `policy` would if the situation were `held`, shape (12,), all the time.

    The constant inputs become a part of the biases of the first layer.
    """
    (weights, biases), *others = policy.layers
    parts = [held, *(np.tanh(np.float32(scale) * held) for scale in policy.input_scales)]
    blocks = weights.reshape(len(parts), -1, weights.shape[1])
    for part, block in zip(parts, blocks, strict=True):
        biases = biases + part @ block[-SITUATION_SIZE:]
    kept = blocks[:, :-SITUATION_SIZE].reshape(-1, weights.shape[1])
    hybrid = {key: value for key, value in policy.card["hybrid"].items() if key != "situation"}
    return MlpPolicy([(kept, biases), *others], {**policy.card, "hybrid": hybrid})


def measure(
    name: str, scenarios: Mapping[str, Any], episodes: int, seed: int, cache: Path | None, jobs: int
) -> dict[str, dict[str, Interval]]:
    """Return, for each scenario, the metrics of the policy, of the policy without situation, and their differences.

    Args:
        name: Name of the policy, see `load_policies`.
        scenarios: Scenarios by name, as for `compare`.
        episodes: Number of episodes in each scenario.
        seed: Seed of the first episode.
        cache: Folder of cached results of the policy.
        jobs: Number of processes.
    """
    policies = adaptive_policies(name)
    held: Any = [without_situation(policy, mean_situation(policy)) for policy in policies]
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
    headings = ["scenario", "adaptive (mm)", "situation held at its mean (mm)"]
    headings += ["difference (mm)", "where both survive (mm)", "survival (points)"]
    rows = [[scenario, *(format_interval(value) for value in row.values())] for scenario, row in measured.items()]
    return "\n".join(f"| {' | '.join(line)} |" for line in [headings, ["---"] * len(headings), *rows])


def gains(measured: Mapping[str, Mapping[str, Interval]]) -> dict[str, dict[str, Interval]]:
    """Return the differences for the figure, in mm, by scenario; their axis has the label `LABEL`."""
    shown = {"all episodes, a fall counts as 1 m": "penalised_rmse", "episodes that both survive": "rmse"}
    return {scenario: {label: row[key] for label, key in shown.items()} for scenario, row in measured.items()}


def save(measured: Mapping[str, Mapping[str, Interval]], provenance: Mapping[str, Any], path: Path) -> None:
    """Write the numbers as JSON: penalised RMSE and differences in mm, survival in percentage points."""
    data = {"provenance": provenance, "results": to_json_data(measured)}
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
