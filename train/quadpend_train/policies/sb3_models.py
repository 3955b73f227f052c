"""Models of Stable-Baselines3 and sb3-contrib: their classes, networks and files."""

import json
import zipfile
from pathlib import Path
from typing import Any

import torch

ACTIVATION_MODULES = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh, "elu": torch.nn.ELU}


def algorithm_class(name: str) -> Any:
    """The class of an algorithm.

    Raises:
        ValueError: it is not installed.
    """
    if name == "tqc":
        try:
            from sb3_contrib import TQC
        except ImportError as error:
            raise ValueError("TQC is in sb3-contrib: pip install 'quadpend-gym[train]'") from error
        return TQC
    from stable_baselines3 import PPO, SAC

    return {"ppo": PPO, "sac": SAC}[name]


def output_layer(model: Any) -> Any:
    """The last layer of the policy's network."""
    return model.policy.action_net if hasattr(model.policy, "action_net") else model.actor.mu


def read_zip(path: Path) -> Any:
    """The model in a file that PPO, SAC or TQC has saved. Loading it executes code that is in the file.

    Raises:
        ValueError: it is no such file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            saved = json.loads(archive.read("data"))["policy_class"]["__module__"]
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(f"{path} is no model saved by Stable-Baselines3: {error}") from error
    name = next((name for name in ("sac", "tqc") if f".{name}." in saved), "ppo")
    try:
        return algorithm_class(name).load(path, device="cpu")
    except ImportError as error:
        raise ValueError(f"{path} was saved with a package that is not installed: {error}") from error
    except (TypeError, KeyError, ValueError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path} is no model of PPO, SAC or TQC: {error}") from error
