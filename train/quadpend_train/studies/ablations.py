"""Ablations: the same training with and without one part of a learner.

Every ablation compares two trainings that differ in that part and in the settings that depend on it, over the same
training seeds, in the scenario that the part is intended for. `ABLATIONS` has the settings. The timesteps of imitation
count as training timesteps.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import suggest
from quadpend_gym.scenarios import expand_sets, find_scenario
from quadpend_train.common import documents
from quadpend_train.common.executors import run as run_calls
from quadpend_train.common.files import to_json_data, write_text
from quadpend_train.common.provenance import versions
from quadpend_train.evaluation.cache import code_stamp
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.evaluation.formatting import format_interval
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval, mean
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.environment import concatenate_scenarios
from quadpend_train.training.run_folder import POLICY
from quadpend_train.training.settings import TrainSettings, from_mapping, to_mapping
from quadpend_train.training.train import train

TIMESTEPS = 3_000_000  # of a training without a base controller
HYBRID_TIMESTEPS = 1_000_000  # of a hybrid, which performs as well as its base controller from the start
EPISODES = 100
_PARTS = ("without", "with")  # the two trainings of an ablation
_OUTPUT_FEEDBACK = '{"wind": "breeze", "output_feedback": true}'


def _merged(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings with changes; tables of settings are merged too."""
    tables = {name: {**settings.get(name, {}), **value} for name, value in changes.items() if isinstance(value, dict)}
    return {**settings, **changes, **tables}


# Settings of all hybrids that change the base controller's action or its bandwidths.
_HYBRID: dict[str, Any] = {
    "hybrid": {"base_controller": "flatness"},
    "total_timesteps": HYBRID_TIMESTEPS,
    "learning_rate": 1e-3,
    "gamma": 0.99,
    "reward_scale": 0.1,
    "max_episode_steps": 500,
    "ppo": {"log_std_init": -2.0, "gae_lambda": 0.98, "n_epochs": 5},
    "reward": {"tracking": 1.0, "upright": 0.0, "yaw": 0.05, "effort": 0.0, "tip": 0.3},
}
_RESIDUAL_ACTION: dict[str, Any] = {"hybrid": {"mode": "residual_action", "action_scale": 0.3}}
_GAIN_SCHEDULING: dict[str, Any] = {"hybrid": {"mode": "bandwidth_scheduling", "action_scale": 1.0}}
_RELATIVE_REWARD: dict[str, Any] = {"hybrid": {"baseline_relative_reward": True}}
# Action repeat, with the settings that keep horizon and batch the same in control steps.
_ACTION_REPEAT: dict[str, Any] = {
    "hybrid": {"action_repeat": 10},
    "gamma": 0.92,
    "batch_size": 512,
    "total_timesteps": HYBRID_TIMESTEPS // 10,
    "ppo": {"gae_lambda": 0.95, "n_steps": 16},
}
_RELATIVE_GAIN_SCHEDULING = _merged(_merged(_HYBRID, _GAIN_SCHEDULING), _RELATIVE_REWARD)


class Ablation(NamedTuple):
    """A part of a learner, and the settings of two trainings: without and with this part.

    Attributes:
        part: Description of the part.
        scenario: Scenario of the evaluation, and of the training unless the settings name another one.
        without: Changes of the default settings for the training without the part.
        added: Further changes for the training with the part.
    """

    part: str
    scenario: str
    without: Mapping[str, Any]
    added: Mapping[str, Any]


ABLATIONS = {
    "sharp-reward": Ablation(
        "reward with a sharp peak at zero error", "windy", {"reward": {"tip": 0.0}}, {"reward": {"tip": 0.5}}
    ),
    "deso": Ablation(
        "the DESO's disturbance estimate observed", "windy", {}, {"hybrid": {"base_controller": "adrc-matched"}}
    ),
    "kalman": Ablation(
        "the Kalman observer's state and disturbance observed", "windy", {}, {"hybrid": {"base_controller": "flatness"}}
    ),
    "imitation": Ablation(
        "imitation of the flatness-based controller first",
        "windy",
        {"hybrid": {"base_controller": "flatness"}, "ppo": {"log_std_init": -1.0}},
        {"hybrid": {"imitation_timesteps": 250_000}, "total_timesteps": TIMESTEPS - 250_000},
    ),
    "gsde": Ablation("state-dependent exploration", "windy", {}, {"sde_sample_freq": 8}),
    "curriculum": Ablation(
        "curriculum: calm, breeze, then wind",
        "windy",
        {},
        {"curriculum": ("calm", "breeze"), "curriculum_steps": TIMESTEPS // 3},
    ),
    "upset-curriculum": Ablation(
        "curriculum: calm, wind, then upset starts",
        "training_upset",
        {},
        {"curriculum": ("calm", "windy"), "curriculum_steps": TIMESTEPS // 3},
    ),
    "domain-randomization": Ablation(
        "domain randomization of the parameters",
        "training_uncertain",
        {"scenarios": ("breeze",)},
        {"scenarios": ("training_uncertain",)},
    ),
    "history": Ablation(
        "history of four observations and three actions, without velocities",
        _OUTPUT_FEEDBACK,
        {},
        {"history": 4, "history_actions": 3},
    ),
    "residual-action": Ablation(
        "residual action on the flatness-based controller, instead of acting alone",
        "windy",
        _HYBRID,
        _RESIDUAL_ACTION,
    ),
    "residual-action-relative-reward": Ablation(
        "baseline-relative reward for the residual action",
        "windy",
        _merged(_HYBRID, _RESIDUAL_ACTION),
        _RELATIVE_REWARD,
    ),
    "gain-scheduling": Ablation(
        "gain scheduling of the controller's bandwidths, instead of the residual action",
        "windy",
        _merged(_HYBRID, _RESIDUAL_ACTION),
        _GAIN_SCHEDULING,
    ),
    "gain-scheduling-relative-reward": Ablation(
        "baseline-relative reward for gain scheduling",
        "windy",
        _merged(_HYBRID, _GAIN_SCHEDULING),
        _RELATIVE_REWARD,
    ),
    "action-repeat": Ablation(
        "action repeat of ten steps, with gain scheduling and baseline-relative reward",
        "windy",
        _RELATIVE_GAIN_SCHEDULING,
        _ACTION_REPEAT,
    ),
    "fallback": Ablation(
        "fallback to the base controller for late actions and large tilts, trained in all training scenarios",
        "training_lagged",
        {
            **_merged(_RELATIVE_GAIN_SCHEDULING, {"hybrid": {**_ACTION_REPEAT["hybrid"], "failure_penalty": 100.0}}),
            **{name: value for name, value in _ACTION_REPEAT.items() if name != "hybrid"},
            "scenarios": ("training",),
        },
        {"hybrid": {"fallback_gain": 1.0}},
    ),
}
# An additional row, which needs no training: gain scheduling compared with its constant mean.
CONSTANT = "gain scheduling by `ppo-gain-scheduling`, fully trained, instead of its constant mean"
CONSTANT_SCENARIO = "training_upset"


class AblationResult(NamedTuple):
    """Penalised RMSE without and with a part, and the difference; m."""

    without: Interval
    added: Interval
    difference: Interval


def settings_pair(ablation: Ablation, seed: int) -> tuple[TrainSettings, TrainSettings]:
    """Return the settings of the two trainings of an ablation: without and with its part."""
    base = {"scenarios": (ablation.scenario,), "total_timesteps": TIMESTEPS, "seed": seed}
    without = _merged(base, ablation.without)
    added = _merged(without, ablation.added)
    return from_mapping(without, ablation.part), from_mapping(added, ablation.part)


def run(
    folder: Path, seeds: int = 3, names: tuple[str, ...] = tuple(ABLATIONS), jobs: int | Executor = 1
) -> dict[str, AblationResult]:
    """Train and evaluate; trainings that `folder` already has with the same settings are not repeated.

    Args:
        folder: Folder of the run folders and of `ablations.json`.
        seeds: Number of training seeds.
        names: Keys of `ABLATIONS`.
        jobs: Number of processes, or an executor; the results do not depend on it.

    Raises:
        CallsFailedError: If trainings fail; the others are in `folder`.
        ValueError: If a name is unknown.
    """
    if unknown := [name for name in names if name not in ABLATIONS]:
        raise ValueError(
            f"there is no ablation {unknown[0]!r}{suggest(unknown[0], ABLATIONS)}; there are {', '.join(ABLATIONS)}"
        )
    pairs = {(name, seed): settings_pair(ABLATIONS[name], seed) for name in names for seed in range(seeds)}
    runs = {
        (name, part, seed): settings
        for (name, seed), pair in pairs.items()
        for part, settings in zip(_PARTS, pair, strict=True)
    }
    _train_all(runs, folder, jobs)
    evaluations = {
        key: Job(
            str(run_folder(folder, settings) / POLICY),
            find_scenario(ABLATIONS[key[0]].scenario),
            EPISODES,
            VALIDATION_SEED,
        )
        for key, settings in runs.items()
    }
    evaluated = run_jobs(evaluations, processes=jobs)
    results = {}
    for name in names:
        without, added = (
            np.stack([evaluated[name, part, seed].penalised_rmse[0] for seed in range(seeds)]) for part in _PARTS
        )
        results[name] = AblationResult(mean(without).not_negative(), mean(added).not_negative(), mean(added - without))
        print(f"{ABLATIONS[name].part}: {_cells(results[name])}", flush=True)
    if names == tuple(ABLATIONS):
        results["constant"] = _compare_with_constant(seeds)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "ablations.json", json.dumps(to_json_data(results), indent=1) + "\n")
    return results


def _compare_with_constant(seeds: int) -> AblationResult:
    policies = [MlpPolicy.load(f"ppo-gain-scheduling-{seed}") for seed in range(seeds)]
    without, added = (
        np.stack([_penalised_rmse(policy, CONSTANT_SCENARIO) for policy in group])
        for group in ([_with_constant_output(policy) for policy in policies], policies)
    )
    return AblationResult(mean(without).not_negative(), mean(added).not_negative(), mean(added - without))


def _with_constant_output(policy: MlpPolicy) -> MlpPolicy:
    """Return the policy with a constant output: its mean output in the training scenarios."""
    env = concatenate_scenarios([find_scenario(name) for name in expand_sets(("training",))], 8 * 32)
    outputs = [step.memory.output[step.active] for step in rollout(policy, env, VALIDATION_SEED)]
    weights, _ = policy.layers[-1]
    constant = np.concatenate(outputs).mean(axis=0).astype(np.float32)
    return MlpPolicy([*policy.layers[:-1], (np.zeros_like(weights), constant)], policy.card)


def run_folder(folder: Path, settings: TrainSettings) -> Path:
    """Return the folder of the run with certain settings."""
    key = json.dumps([to_mapping(settings), code_stamp(), versions()], sort_keys=True)
    return folder / hashlib.sha256(key.encode()).hexdigest()[:16]


def _train_all(runs: Mapping[Any, TrainSettings], folder: Path, execute: int | Executor) -> None:
    """Make the runs of which `folder` has no finished one. Ablations can have runs in common."""
    names = {run_folder(folder, settings): name for name, settings in runs.items()}
    calls = {}
    for path, name in names.items():
        if not (path / POLICY).is_file():
            shutil.rmtree(path, ignore_errors=True)  # removes what an interrupted training left
            calls[name] = partial(train, runs[name], path, progress=False)
    run_calls(calls, execute, what="training", kept=f"are in {folder}", finished=len(names) - len(calls))


def _penalised_rmse(policy: MlpPolicy, scenario: str) -> Floats:
    """Return the penalised RMSE of each validation episode, m, shape (n,)."""
    return np.asarray(run_episodes([policy], scenario, EPISODES, VALIDATION_SEED).penalised_rmse[0])


def _cells(result: AblationResult) -> str:
    return " | ".join(format_interval(interval.scaled(1e3)) for interval in result)


def label(name: str) -> tuple[str, str]:
    """Return the first two cells of an ablation's row: its part and its scenario."""
    part, scenario = (CONSTANT, CONSTANT_SCENARIO) if name == "constant" else ABLATIONS[name][:2]
    return part, "breeze, no velocities" if scenario == _OUTPUT_FEEDBACK else scenario


def markdown(results: Mapping[str, AblationResult]) -> str:
    """Return a Markdown table with a row for each ablation; numbers in mm."""
    head = "| part | scenario | without | with | difference |\n|---|---|---|---|---|"
    rows = [f"| {' | '.join(label(name))} | {_cells(result)} |" for name, result in results.items()]
    return "\n".join([head, *rows])


def document(results: Mapping[str, AblationResult], path: Path) -> None:
    """Write the table into the generated part ``ablations`` of a document."""
    documents.fill(path, {"ablations": markdown(results)})
