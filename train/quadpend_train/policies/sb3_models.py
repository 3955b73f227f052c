"""Access to models of Stable-Baselines3 and sb3-contrib: their classes, networks and files."""

import importlib
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import sb3_contrib
import stable_baselines3
import torch
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import json_to_data

from quadpend_gym.core.settings import suggest
from quadpend_train.common.text import brief

ACTIVATION_MODULES = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh, "elu": torch.nn.ELU}
# Algorithms of the policies that are not in the package of their algorithm; A2C and TRPO have the policy of PPO
_OF_COMMON_POLICIES = {"stable_baselines3.common": PPO, "sb3_contrib.common.recurrent": RecurrentPPO}


class MultiScaleInputs(torch.nn.Module):
    """The map of an input x to [x, tanh(s₁ x), tanh(s₂ x), …], also a features extractor for Stable-Baselines3."""

    def __init__(self, observation_space: spaces.Box, scales: Sequence[float]) -> None:
        super().__init__()
        self.scales = tuple(scales)
        self.features_dim = observation_space.shape[0] * (1 + len(self.scales))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return features of shape (n, features_dim) of inputs of shape (n, m)."""
        return torch.cat([inputs, *(torch.tanh(scale * inputs) for scale in self.scales)], dim=-1)


def algorithm_class(name: str) -> Any:
    """Return the class of an algorithm by its name in Stable-Baselines3 or sb3-contrib, in any case."""
    found = {
        label.lower(): item
        for label, item in (*vars(stable_baselines3).items(), *vars(sb3_contrib).items())
        if isinstance(item, type) and issubclass(item, BaseAlgorithm)
    }
    if name.lower() not in found:
        known = ["apg", *found]
        raise ValueError(f"algo must be one of {', '.join(known)}, not {name!r}{suggest(name, known)}")
    return found[name.lower()]


def mean_action(model: Any, observation: torch.Tensor) -> torch.Tensor:
    """Return the deterministic action as a differentiable tensor; PPO's policy does not bound it."""
    policy = model.policy
    if not hasattr(policy, "action_net"):
        return policy.actor._predict(observation, deterministic=True)  # type: ignore[no-any-return]
    features = policy.extract_features(observation, policy.pi_features_extractor)
    return policy.action_net(policy.mlp_extractor.forward_actor(features))  # type: ignore[no-any-return]


def actor_modules(model: Any) -> list[torch.nn.Module]:
    """Return the modules between a model's observation and its deterministic action, in order."""
    policy = model.policy
    if hasattr(policy, "mlp_extractor") and not hasattr(policy, "lstm_actor"):  # PPO, A2C, TRPO
        return [*_multi_scale(policy), policy.mlp_extractor.policy_net, policy.action_net]
    if hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):  # SAC, TQC
        return [*_multi_scale(policy.actor), policy.actor.latent_pi, policy.actor.mu, torch.nn.Tanh()]
    if isinstance(getattr(policy, "actor", None), torch.nn.Module) and hasattr(policy.actor, "mu"):  # TD3, DDPG
        return [policy.actor.mu]
    if hasattr(policy, "action_net") and not hasattr(policy, "lstm_actor"):  # ARS
        return [policy.action_net]
    raise ValueError(
        f"the policy of {type(model).__name__} is not a feedforward network of PyTorch: the model flies by its zip, but"
        " it is not exported"
    )


def linear_layers(model: Any) -> list[torch.nn.Linear]:
    """Return the linear layers of a model's policy network, in order."""
    return [item for part in actor_modules(model) for item in part.modules() if isinstance(item, torch.nn.Linear)]


def _multi_scale(part: Any) -> list[torch.nn.Module]:
    """Return the features extractor of a policy or of an actor if it changes the inputs."""
    return [part.features_extractor] if isinstance(part.features_extractor, MultiScaleInputs) else []


def read_zip(path: Path) -> Any:
    """Load a model from a file saved by Stable-Baselines3 or sb3-contrib, or by a library with the same interface.

    Loading executes code that is in the file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            kind = _algorithm(json_to_data(archive.read("data").decode())["policy_class"])
        # Running a model needs no replay buffer, which could be larger than the memory.
        return kind.load(path, device="cpu", custom_objects={"buffer_size": 1})
    except ImportError as error:
        raise ValueError(f"{path} needs a package that is not installed: {error}") from error
    except Exception as error:  # a model can contain any code
        raise ValueError(f"{path} is not a model saved by Stable-Baselines3: {brief(error)}") from error


def _algorithm(policy: type[Any]) -> Any:
    """Return an algorithm with a class of policies, the only class that a file names: it is in the package of both."""
    for kind in policy.__mro__:
        package = kind.__module__.rpartition(".")[0] or kind.__module__
        if package in _OF_COMMON_POLICIES:
            return _OF_COMMON_POLICIES[package]
        for item in vars(importlib.import_module(package)).values():
            if isinstance(item, type) and issubclass(item, BaseAlgorithm) and item.__module__.startswith(package):
                return item
    raise ValueError(f"there is no algorithm for {policy.__name__}")
