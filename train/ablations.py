"""What each part of a learner is worth: the same training with it and without it.

Every line compares two trainings that differ in one thing, over the same seeds, in the scenario that the part is for.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.arrays import Floats
from train import documents
from train.files import plain
from train.flights import VALIDATION_SEED, fly
from train.learned import LearnedPolicy
from train.report import estimate
from train.settings import TrainSettings, from_mapping, to_mapping
from train.statistics import Interval, mean
from train.train import SETTINGS, train

STEPS = 1_500_000
EPISODES = 100
_HIDDEN = '{"wind": "breeze", "output_feedback": true}'
_PACE = {
    "companion": "flatness",
    "steers": "pace",
    "authority": 1.0,
    "learning_rate": 1e-3,
    "discount": 0.99,
    "reward_scale": 0.1,
    "episode_steps": 500,
    "ppo": {"initial_log_std": -1.5, "gae_lambda": 0.98, "epochs": 5},
    "reward": {"tracking": 1.0, "upright": 0.0, "yaw": 0.05, "effort": 0.0, "tip": 0.3},
}
_HELD = {
    "paired": True,
    "hold": 10,
    "discount": 0.92,
    "batch_size": 512,
    "total_steps": STEPS // 10,
    "ppo": {"initial_log_std": -1.5, "gae_lambda": 0.95, "epochs": 5, "rollout_steps": 16},
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
        {"imitation_steps": 250_000},
    ),
    "gsde": Ablation("state-dependent exploration", "windy", {}, {"exploration_steps": 8}),
    "curriculum": Ablation(
        "curriculum: calm, breeze, then wind",
        "windy",
        {},
        {"curriculum": ("calm", "breeze"), "curriculum_steps": 500_000},
    ),
    "upset curriculum": Ablation(
        "curriculum: calm, wind, then upset starts",
        "training_upset",
        {},
        {"curriculum": ("calm", "windy"), "curriculum_steps": 500_000},
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
        "corrections of the flatness-based controller's action",
        "windy",
        {"companion": "flatness"},
        {"steers": "action", "authority": 0.3, "ppo": {"initial_log_std": -2.0}},
    ),
    "paired residual": Ablation(
        "the same, rewarded relative to the controller alone",
        "windy",
        {"companion": "flatness", "steers": "action", "authority": 0.3, "ppo": {"initial_log_std": -2.0}},
        {"paired": True},
    ),
    "pace": Ablation("setting its bandwidths instead of acting", "windy", {"companion": "flatness"}, _PACE),
    "paired pace": Ablation("the same, rewarded relative to the controller alone", "windy", _PACE, {"paired": True}),
    "held pace": Ablation("and held for ten steps", "windy", {**_PACE, "paired": True}, _HELD),
}


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
    (folder / "ablations.json").write_text(json.dumps(plain(outcomes), indent=1) + "\n", encoding="utf-8")
    return outcomes


def _flown(settings: TrainSettings, scenario: str, folder: Path) -> Floats:
    """Penalised RMSE of each episode, m, shape (n,)."""
    data = json.dumps(to_mapping(settings), sort_keys=True)
    for kept in folder.glob(f"*/{SETTINGS}"):
        same = json.dumps(json.loads(kept.read_text(encoding="utf-8")), sort_keys=True) == data
        if same and (kept.parent / "policy.npz").is_file():
            policy = kept.parent / "policy.npz"
            break
    else:
        number = len(list(folder.glob("run-*")))
        policy = train(settings, folder / f"run-{number}", progress=False)
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
        ablation = ABLATIONS[name]
        where = "breeze, no velocities" if ablation.scenario == _HIDDEN else ablation.scenario
        rows.append(f"| {ablation.part} | {where} | {_cells(outcome)} |")
    return "\n".join([head, *rows])


def document(outcomes: Mapping[str, Outcome], path: Path) -> None:
    """Fill in the part ``ablations`` of a document."""
    documents.fill(path, {"ablations": markdown(outcomes)})
