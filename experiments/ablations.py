"""Part of docs/results/tables.md: the same training with and without one part of a learner.

    python -m experiments.ablations --jobs 2      # three training seeds; about ten hours; runs/ablations/

Every ablation compares two trainings that differ in that part and in the settings that depend on it, over the same
training seeds, in the scenario that the part is intended for, in 100 episodes with seeds from 3000000. The timesteps of
imitation count as training timesteps. A finished run is found again by its settings and is not repeated: delete its
folder after a change of the code that should change it.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from experiments.pages import DOCS, fill, options
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.files import read_mapping
from quadpend_gym.scenarios import find_scenarios
from quadpend_train.common import executors
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.statistics import mean
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.environment import concatenate_scenarios
from quadpend_train.training.settings import TrainSettings, from_mapping, to_mapping
from quadpend_train.training.train import train_or_resume

RUNS = Path("runs/ablations")
TIMESTEPS = 3_000_000  # of a training whose settings do not say otherwise
SEEDS, EPISODES = 3, 100


class Ablation(NamedTuple):
    """One ablation of ablations.toml, which describes the fields; the scenario is also that of the evaluation."""

    title: str
    scenario: str = "windy"
    base: Sequence[str] = ()
    part: Sequence[str] = ()
    without: Mapping[str, Any] = MappingProxyType({})
    added: Mapping[str, Any] = MappingProxyType({})


_FILE = read_mapping(Path(__file__).with_suffix(".toml"))
ABLATIONS = {name: Ablation(**fields) for name, fields in _FILE["ablations"].items()}
# An additional row, which needs no training: gain scheduling compared with its constant mean.
CONSTANT = "gain scheduling by `ppo-gain-scheduling`, fully trained, instead of its constant mean"
CONSTANT_SCENARIO = "training_upset"


def _merged(*parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with the later ones in place of the earlier; tables of settings are merged too."""
    merged: dict[str, Any] = {}
    for part in parts:
        for name, value in part.items():
            merged[name] = {**merged.get(name, {}), **value} if isinstance(value, dict) else value
    return merged


def settings_pair(ablation: Ablation, seed: int) -> tuple[TrainSettings, TrainSettings]:
    """Return the settings of the two trainings of an ablation: without and with its part."""
    start = {"scenarios": (ablation.scenario,), "total_timesteps": TIMESTEPS, "seed": seed}
    base, part = ([_FILE["shared"][name] for name in names] for names in (ablation.base, ablation.part))
    without = _merged(start, *base, ablation.without)
    added = _merged(without, *part, ablation.added)
    return from_mapping(without, ablation.title), from_mapping(added, ablation.title)


def trained(settings: TrainSettings) -> MlpPolicy:
    """Return the policy of the run with these settings, after training it if there is none."""
    key = json.dumps(to_mapping(settings), sort_keys=True)
    folder = RUNS / hashlib.sha256(key.encode()).hexdigest()[:16]
    path = folder / "policy.npz"
    return MlpPolicy.load(path if path.is_file() else train_or_resume(settings, folder, progress=False))


def penalised_rmse(policy: MlpPolicy, scenario: str) -> Floats:
    """Return the penalised RMSE of each validation episode, mm, shape (n,)."""
    return 1000.0 * np.asarray(run_episodes([policy], scenario, EPISODES, VALIDATION_SEED).penalised_rmse[0])


def with_constant_output(policy: MlpPolicy) -> MlpPolicy:
    """Return the policy with a constant output: its mean output in the training scenarios."""
    env = concatenate_scenarios([*find_scenarios("training").values()], 8 * 32)
    outputs = [step.memory.output[step.active] for step in rollout(policy, env, VALIDATION_SEED)]
    weights, _ = policy.layers[-1]
    constant = np.concatenate(outputs).mean(axis=0).astype(np.float32)
    return MlpPolicy([*policy.layers[:-1], (np.zeros_like(weights), constant)], policy.card)


def row(part: str, scenario: str, without: Floats, added: Floats) -> list[str]:
    """Return a row of the table from the penalised RMSE, mm, shape (seeds, n)."""
    values = mean(without).clipped(0.0), mean(added).clipped(0.0), mean(added - without)
    place = "breeze, no velocities" if "output_feedback" in scenario else scenario
    return [part, place, *map(format_interval, values)]


def main() -> None:
    """Train, evaluate, and fill the page."""
    given = options(__doc__, EPISODES)
    pairs = {name: [settings_pair(item, seed) for seed in range(SEEDS)] for name, item in ABLATIONS.items()}
    runs = {json.dumps(to_mapping(run)): run for pair in pairs.values() for both in pair for run in both}
    executors.run({key: partial(trained, run) for key, run in runs.items()}, given.jobs, what="training")
    rows = []
    for name, (part, scenario, *_) in ABLATIONS.items():
        errors = [[penalised_rmse(trained(run), scenario) for run in both] for both in zip(*pairs[name], strict=True)]
        rows.append(row(part, scenario, *map(np.stack, errors)))
    policies = [MlpPolicy.load(f"ppo-gain-scheduling-{seed}") for seed in range(SEEDS)]
    groups = [[with_constant_output(policy) for policy in policies], policies]
    errors = [[penalised_rmse(policy, CONSTANT_SCENARIO) for policy in group] for group in groups]
    rows.append(row(CONSTANT, CONSTANT_SCENARIO, *map(np.stack, errors)))
    table = markdown_table(["part", "scenario", "without", "with", "difference"], rows)
    fill(DOCS / "results/tables.md", {"ablations": table})
    print(table)


if __name__ == "__main__":
    main()
