"""Brief training runs and their results."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.policies.sb3_models import algorithm_class
from quadpend_train.training import callbacks
from quadpend_train.training import train as training
from quadpend_train.training.algorithms import load_model
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import TrainSettings

# Scenarios whose episodes end after a few steps for every policy.
SHORT = json.dumps({"wind": "windy", "task": {"limits": {"pendulum_angle": 0.06}}})
OTHER = json.dumps({"wind": "breeze", "task": {"limits": {"pendulum_angle": 0.07}}})
BRIEF = TrainSettings(
    scenarios=(SHORT,),
    total_timesteps=1024,
    num_envs=16,
    n_eval_episodes=2,
    arguments={"n_steps": 16, "n_epochs": 1, "batch_size": 128, "policy_kwargs": {"net_arch": (8,)}},
)
SAC = {
    **{"gradient_steps": 1, "buffer_size": 1024, "learning_starts": 64, "batch_size": 32},
    "policy_kwargs": {"net_arch": (8,)},
}
BRIEF_SAC = replace(BRIEF, algo="sac", total_timesteps=512, arguments=SAC)


def with_arguments(settings: TrainSettings, **arguments: Any) -> TrainSettings:
    """Return settings with other keyword arguments of the algorithm."""
    return replace(settings, arguments={**settings.arguments, **arguments})


def train_policy(settings: TrainSettings, folder: Path, **options: Any) -> MlpPolicy:
    """Train from scratch and return the policy."""
    return MlpPolicy.load(training.train(settings, folder, progress=False, **options))


def model_of(folder: Path, settings: TrainSettings) -> Any:
    """Return the model of a finished run."""
    if settings.algo == "apg":
        return load_model(settings, make_env(settings), folder / "model.zip")
    return algorithm_class(settings.algo).load(folder / "model.zip", device="cpu")


def weight_difference(policy: MlpPolicy, other: MlpPolicy) -> float:
    """Return the largest absolute difference of the weights of two policies with the same layers."""
    own, others = ([array for layer in item.layers for array in layer] for item in (policy, other))
    return max(float(np.abs(a - b).max()) for a, b in zip(own, others, strict=True))


def trained_arrays(model: Any) -> list[Any]:
    """Return everything that training changes: networks, target networks, optimizers and entropy coefficient."""
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
    """Interrupt training as soon as it has taken so many steps."""

    def interrupt(callback: callbacks.StopConditions) -> bool:
        if callback.num_timesteps >= steps:
            raise KeyboardInterrupt
        return True

    patch.setattr(callbacks.StopConditions, "_on_step", interrupt)
