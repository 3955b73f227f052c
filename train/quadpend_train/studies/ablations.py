"""What each part of a learner is worth: the same training with it and without it.

Every line compares two trainings that differ in that part and what follows from it (`ABLATIONS` has the settings), over
the same seeds, in the scenario that the part is for. Steps are the environment's, those of an imitation included.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.arrays import Floats
from quadpend_train.common import documents
from quadpend_train.common.files import to_json_data
from quadpend_train.common.provenance import versions
from quadpend_train.evaluation.cache import code_stamp
from quadpend_train.evaluation.episodes import VALIDATION_SEED, run_episodes
from quadpend_train.evaluation.formatting import format_interval
from quadpend_train.evaluation.statistics import Interval, mean
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.scenarios import expand, find_scenario
from quadpend_train.training.environment import concatenate_scenarios
from quadpend_train.training.settings import TrainSettings, from_mapping, to_mapping
from quadpend_train.training.train import POLICY, train

STEPS = 3_000_000  # of learners that act alone
BESIDE_STEPS = 1_000_000  # of those that steer a controller, and begin as good as it
EPISODES = 100
_HIDDEN = '{"wind": "breeze", "output_feedback": true}'
# What trainings beside a controller share, whatever of it they steer.
_BESIDE: dict[str, Any] = {
    "hybrid": {"base_controller": "flatness"},
    "total_timesteps": BESIDE_STEPS,
    "learning_rate": 1e-3,
    "gamma": 0.99,
    "reward_scale": 0.1,
    "max_episode_steps": 500,
    "ppo": {"log_std_init": -2.0, "gae_lambda": 0.98, "n_epochs": 5},
    "reward": {"tracking": 1.0, "upright": 0.0, "yaw": 0.05, "effort": 0.0, "tip": 0.3},
}
_RESIDUAL: dict[str, Any] = {
    **_BESIDE,
    "hybrid": {"base_controller": "flatness", "mode": "residual_action", "action_scale": 0.3},
}
_SCHEDULING: dict[str, Any] = {
    **_BESIDE,
    "hybrid": {"base_controller": "flatness", "mode": "bandwidth_scheduling", "action_scale": 1.0},
}
_RELATIVE: dict[str, Any] = {"hybrid": {"baseline_relative_reward": True}}
_RELATIVE_SCHEDULING: dict[str, Any] = {**_SCHEDULING, "hybrid": {**_SCHEDULING["hybrid"], **_RELATIVE["hybrid"]}}
_HELD: dict[str, Any] = {  # and what follows from it: the same horizons and batches, in decisions
    "hybrid": {"action_repeat": 10},
    "gamma": 0.92,
    "batch_size": 512,
    "total_timesteps": BESIDE_STEPS // 10,
    "ppo": {"gae_lambda": 0.95, "n_steps": 16},
}


class Ablation(NamedTuple):
    """A part, and the two trainings that show its worth, as changes of the demo's settings."""

    part: str
    scenario: str  # trained and flown in
    without: Mapping[str, Any]
    added: Mapping[str, Any]  # on top of `without`


ABLATIONS = {
    "tip": Ablation("reward with a sharp tip", "windy", {"reward": {"tip": 0.0}}, {"reward": {"tip": 0.5}}),
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
        {"hybrid": {"imitation_timesteps": 250_000}, "total_timesteps": STEPS - 250_000},
    ),
    "gsde": Ablation("state-dependent exploration", "windy", {}, {"sde_sample_freq": 8}),
    "curriculum": Ablation(
        "curriculum: calm, breeze, then wind",
        "windy",
        {},
        {"curriculum": ("calm", "breeze"), "curriculum_steps": STEPS // 3},
    ),
    "upset curriculum": Ablation(
        "curriculum: calm, wind, then upset starts",
        "training_upset",
        {},
        {"curriculum": ("calm", "windy"), "curriculum_steps": STEPS // 3},
    ),
    "randomisation": Ablation(
        "parameters drawn in training",
        "training_uncertain",
        {"scenario": ("breeze",)},
        {"scenario": ("training_uncertain",)},
    ),
    "history": Ablation(
        "four observations and three actions, without velocities",
        _HIDDEN,
        {},
        {"history": 4, "history_actions": 3},
    ),
    "residual": Ablation(
        "corrections of the flatness-based controller's action, instead of acting alone",
        "windy",
        _BESIDE,
        {"hybrid": {"mode": "residual_action", "action_scale": 0.3}},
    ),
    "paired residual": Ablation("the same, rewarded relative to the controller", "windy", _RESIDUAL, _RELATIVE),
    "pace": Ablation("setting its bandwidths, instead of correcting its action", "windy", _RESIDUAL, _SCHEDULING),
    "paired pace": Ablation("the same, rewarded relative to the controller", "windy", _SCHEDULING, _RELATIVE),
    "held pace": Ablation("and held for ten steps", "windy", _RELATIVE_SCHEDULING, _HELD),
    "caution": Ablation(
        "and, trained in all training scenarios, trusted less where actions come late or it leans far",
        "training_lagged",
        {
            **_RELATIVE_SCHEDULING,
            **_HELD,
            "scenario": ("training",),
            "hybrid": {**_RELATIVE_SCHEDULING["hybrid"], **_HELD["hybrid"], "failure_penalty": 100.0},
        },
        {"hybrid": {"fallback_gain": 1.0}},
    ),
}
CONSTANT = "the pace decided anew, instead of its mean (`ppo-pace`, trained in full)"
CONSTANT_SCENARIO = "training_upset"


class Outcome(NamedTuple):
    """Penalised RMSE (m), and how much the part adds to it."""

    without: Interval
    added: Interval
    difference: Interval


def settings_of(ablation: Ablation, seed: int) -> tuple[TrainSettings, TrainSettings]:
    """The two trainings of an ablation."""
    base = {"scenario": (ablation.scenario,), "total_timesteps": STEPS, "seed": seed}
    without = _merged(base, ablation.without)
    return tuple(from_mapping(part, ablation.part) for part in (without, _merged(without, ablation.added)))  # type: ignore[return-value]


def run(folder: Path, seeds: int = 3, names: tuple[str, ...] = tuple(ABLATIONS)) -> dict[str, Outcome]:
    """Train and fly; what is trained in `folder` already with the same settings is not trained again.

    Raises:
        ValueError: there is no such ablation.
    """
    if unknown := [name for name in names if name not in ABLATIONS]:
        raise ValueError(f"there is no ablation {unknown[0]!r}; there are {', '.join(ABLATIONS)}")
    outcomes = {}
    for name in names:
        pairs = [settings_of(ABLATIONS[name], seed) for seed in range(seeds)]
        without, added = (
            np.stack([_flown(side, ABLATIONS[name].scenario, folder) for side in sides])
            for sides in zip(*pairs, strict=True)
        )
        outcomes[name] = Outcome(mean(without), mean(added), mean(added - without))
        print(f"{ABLATIONS[name].part}: {_cells(outcomes[name])}", flush=True)
    if names == tuple(ABLATIONS):
        outcomes["constant"] = _constant_outcome(seeds)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "ablations.json").write_text(json.dumps(to_json_data(outcomes), indent=1) + "\n", encoding="utf-8")
    return outcomes


def _constant_outcome(seeds: int) -> Outcome:
    policies = [MlpPolicy.load(f"ppo-gain-scheduling-{seed}") for seed in range(seeds)]
    without, added = (
        np.stack(
            [run_episodes([policy], CONSTANT_SCENARIO, EPISODES, VALIDATION_SEED).penalised_rmse[0] for policy in group]
        )
        for group in ([_at_its_mean(policy) for policy in policies], policies)
    )
    return Outcome(mean(without), mean(added), mean(added - without))


def _at_its_mean(policy: MlpPolicy) -> MlpPolicy:
    """The policy with what it decides on average in the training scenarios, always."""
    env = concatenate_scenarios([find_scenario(name) for name in expand(("training",))], 8 * 32)
    decided = [step.memory.output[step.active] for step in rollout(policy, env, VALIDATION_SEED)]
    weights, _ = policy.layers[-1]
    constant = np.concatenate(decided).mean(axis=0).astype(np.float32)
    return MlpPolicy([*policy.layers[:-1], (np.zeros_like(weights), constant)], policy.card)


def _flown(settings: TrainSettings, scenario: str, folder: Path) -> Floats:
    """Penalised RMSE of each episode, m, shape (n,)."""
    said = json.dumps([to_mapping(settings), code_stamp(), versions()], sort_keys=True)
    run = folder / hashlib.sha256(said.encode()).hexdigest()[:16]
    policy = run / POLICY
    if not policy.is_file():
        shutil.rmtree(run, ignore_errors=True)  # of an interruption
        train(settings, run, progress=False)
    flights = run_episodes([MlpPolicy.load(policy)], scenario, EPISODES, VALIDATION_SEED)
    return np.asarray(flights.penalised_rmse[0])


def _merged(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    nested = {name: {**settings.get(name, {}), **value} for name, value in changes.items() if isinstance(value, dict)}
    return {**settings, **changes, **nested}


def _cells(outcome: Outcome) -> str:
    return " | ".join(format_interval(part.scaled(1e3)) for part in outcome)


def markdown(outcomes: Mapping[str, Outcome]) -> str:
    """A line for each part, mm."""
    head = "| part | scenario | without | with | difference |\n|---|---|---|---|---|"
    rows = []
    for name, outcome in outcomes.items():
        part, scenario = (CONSTANT, CONSTANT_SCENARIO) if name == "constant" else ABLATIONS[name][:2]
        where = "breeze, no velocities" if scenario == _HIDDEN else scenario
        rows.append(f"| {part} | {where} | {_cells(outcome)} |")
    return "\n".join([head, *rows])


def document(outcomes: Mapping[str, Outcome], path: Path) -> None:
    """Fill in the part ``ablations`` of a document."""
    documents.fill(path, {"ablations": markdown(outcomes)})
