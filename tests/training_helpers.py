"""Brief training runs, and what comes out of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from train import callbacks
from train import train as training
from train.algorithms import algorithm
from train.learned import LearnedPolicy
from train.settings import PpoSettings, SacSettings, TrainSettings

# Episodes that end after a few steps, whoever flies.
SHORT = json.dumps({"wind": "windy", "task": {"limits": {"pendulum_angle": 0.06}}})
OTHER = json.dumps({"wind": "breeze", "task": {"limits": {"pendulum_angle": 0.07}}})
BRIEF = TrainSettings(
    scenario=(SHORT,),
    total_steps=1024,
    num_envs=16,
    batch_size=128,
    hidden=(8,),
    evaluation_episodes=2,
    ppo=PpoSettings(rollout_steps=16, epochs=1),
    sac=SacSettings(gradient_steps=1, buffer_size=1024, learning_starts=64),
)
BRIEF_SAC = replace(BRIEF, algo="sac", total_steps=512, batch_size=32)


def trained(settings: TrainSettings, folder: Path, **more: Any) -> LearnedPolicy:
    """The policy of a run from scratch."""
    return LearnedPolicy.load(training.train(settings, folder, progress=False, **more))


def model_of(folder: Path, settings: TrainSettings) -> Any:
    """The model that a finished run has left."""
    return algorithm(settings.algo).load(folder / "model.zip", device="cpu")


def numbers_of(model: Any) -> list[Any]:
    """All that a model has learned: networks, target networks, optimizers, and the entropy's weight."""
    found: list[Any] = [*model.policy.state_dict().values()]
    optimizers = [model.policy.optimizer] if hasattr(model.policy, "optimizer") else []
    for part in ("actor", "critic"):
        optimizers += [getattr(model.policy, part).optimizer] if hasattr(model.policy, part) else []
    if (entropy := getattr(model, "ent_coef_optimizer", None)) is not None:
        optimizers.append(entropy)
        found.append(model.log_ent_coef.detach())
    for optimizer in optimizers:
        for state in optimizer.state_dict()["state"].values():
            found += [value for value in state.values() if isinstance(value, torch.Tensor)]
    return [item.numpy() for item in found]


def interrupt_at(steps: int, patch: pytest.MonkeyPatch) -> None:
    """Let training be interrupted as soon as it has taken so many steps."""

    def interrupted(watch: callbacks.Watch) -> bool:
        if watch.num_timesteps >= steps:
            raise KeyboardInterrupt
        return True

    patch.setattr(callbacks.Watch, "_on_step", interrupted)
