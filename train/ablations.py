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

from baselines.rollout import rollout
from quadpend_gym.arrays import Floats
from train import documents
from train.environment import together
from train.files import plain
from train.flights import VALIDATION_SEED, fly
from train.learned import LearnedPolicy
from train.origin import versions
from train.report import estimate
from train.scenarios import expand, find_scenario
from train.settings import TrainSettings, from_mapping, to_mapping
from train.statistics import Interval, mean
from train.store import code_stamp
from train.train import POLICY, train

STEPS = 3_000_000  # of learners that act alone
BESIDE_STEPS = 1_000_000  # of those that steer a controller, and begin as good as it
EPISODES = 100
_HIDDEN = '{"wind": "breeze", "output_feedback": true}'
# What trainings beside a controller share, whatever of it they steer.
_BESIDE = {
    "companion": "flatness",
    "total_steps": BESIDE_STEPS,
    "learning_rate": 1e-3,
    "discount": 0.99,
    "reward_scale": 0.1,
    "episode_steps": 500,
    "ppo": {"initial_log_std": -2.0, "gae_lambda": 0.98, "epochs": 5},
    "reward": {"tracking": 1.0, "upright": 0.0, "yaw": 0.05, "effort": 0.0, "tip": 0.3},
}
_RESIDUAL = {**_BESIDE, "steers": "action", "authority": 0.3}
_PACE = {**_BESIDE, "steers": "pace", "authority": 1.0}
_HELD = {  # and what follows from it: the same horizons and batches, in decisions
    "hold": 10,
    "discount": 0.92,
    "batch_size": 512,
    "total_steps": BESIDE_STEPS // 10,
    "ppo": {"gae_lambda": 0.95, "rollout_steps": 16},
}


class Ablation(NamedTuple):
    """A part, and the two trainings that show its worth, as changes of the demo's settings."""

    part: str
    scenario: str  # trained and flown in
    without: Mapping[str, Any]
    added: Mapping[str, Any]  # on top of `without`


ABLATIONS = {
    "tip": Ablation("reward with a sharp tip", "windy", {"reward": {"tip": 0.0}}, {"reward": {"tip": 0.5}}),
    "deso": Ablation("the DESO's disturbance estimate observed", "windy", {}, {"companion": "adrc-matched"}),
    "kalman": Ablation("the Kalman observer's state and disturbance observed", "windy", {}, {"companion": "flatness"}),
    "imitation": Ablation(
        "imitation of the flatness-based controller first",
        "windy",
        {"companion": "flatness", "ppo": {"initial_log_std": -1.0}},
        {"imitation_steps": 250_000, "total_steps": STEPS - 250_000},
    ),
    "gsde": Ablation("state-dependent exploration", "windy", {}, {"exploration_steps": 8}),
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
        {"steers": "action", "authority": 0.3},
    ),
    "paired residual": Ablation("the same, rewarded relative to the controller", "windy", _RESIDUAL, {"paired": True}),
    "pace": Ablation("setting its bandwidths, instead of correcting its action", "windy", _RESIDUAL, _PACE),
    "paired pace": Ablation("the same, rewarded relative to the controller", "windy", _PACE, {"paired": True}),
    "held pace": Ablation("and held for ten steps", "windy", {**_PACE, "paired": True}, _HELD),
    "caution": Ablation(
        "and, trained in all training scenarios, trusted less where actions come late or it leans far",
        "training_lagged",
        {"scenario": ("training",), **_PACE, "paired": True, **_HELD, "fall_cost": 100.0},
        {"caution": 1.0},
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
    base = {"scenario": (ablation.scenario,), "total_steps": STEPS, "seed": seed}
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
    (folder / "ablations.json").write_text(json.dumps(plain(outcomes), indent=1) + "\n", encoding="utf-8")
    return outcomes


def _constant_outcome(seeds: int) -> Outcome:
    policies = [LearnedPolicy.load(f"ppo-pace-{seed}") for seed in range(seeds)]
    without, added = (
        np.stack([fly([policy], CONSTANT_SCENARIO, EPISODES, VALIDATION_SEED).penalised_rmse[0] for policy in group])
        for group in ([_at_its_mean(policy) for policy in policies], policies)
    )
    return Outcome(mean(without), mean(added), mean(added - without))


def _at_its_mean(policy: LearnedPolicy) -> LearnedPolicy:
    """The policy with what it decides on average in the training scenarios, always."""
    env = together([find_scenario(name) for name in expand(("training",))], 8 * 32)
    decided = [step.memory.held[step.flying] for step in rollout(policy, env, VALIDATION_SEED)]
    weights, _ = policy.layers[-1]
    constant = np.concatenate(decided).mean(axis=0).astype(np.float32)
    return LearnedPolicy([*policy.layers[:-1], (np.zeros_like(weights), constant)], policy.card)


def _flown(settings: TrainSettings, scenario: str, folder: Path) -> Floats:
    """Penalised RMSE of each episode, m, shape (n,)."""
    said = json.dumps([to_mapping(settings), code_stamp(), versions()], sort_keys=True)
    run = folder / hashlib.sha256(said.encode()).hexdigest()[:16]
    policy = run / POLICY
    if not policy.is_file():
        shutil.rmtree(run, ignore_errors=True)  # of an interruption
        train(settings, run, progress=False)
    flights = fly([LearnedPolicy.load(policy)], scenario, EPISODES, VALIDATION_SEED)
    return np.asarray(flights.penalised_rmse[0])


def _merged(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    nested = {name: {**settings.get(name, {}), **value} for name, value in changes.items() if isinstance(value, dict)}
    return {**settings, **changes, **nested}


def _cells(outcome: Outcome) -> str:
    return " | ".join(estimate(part.scaled(1e3)) for part in outcome)


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
