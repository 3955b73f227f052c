"""Access to models of Stable-Baselines3 and sb3-contrib: their classes, networks and files."""

import json
import zipfile
from pathlib import Path
from typing import Any

import torch

ACTIVATION_MODULES = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh, "elu": torch.nn.ELU}


def algorithm_class(name: str) -> Any:
    """Return the class of an algorithm.

    Args:
        name: ``"ppo"``, ``"sac"`` or ``"tqc"``.

    Raises:
        ValueError: If the package of the algorithm is not installed.
    """
    if name == "tqc":
        try:
            from sb3_contrib import TQC
        except ImportError as error:
            raise ValueError("TQC needs sb3-contrib: pip install 'quadpend-gym[train]'") from error
        return TQC
    from stable_baselines3 import PPO, SAC

    return {"ppo": PPO, "sac": SAC}[name]


def is_on_policy(model: Any) -> bool:
    """Return whether a model is on-policy: PPO's policy has an `action_net`, the policies of SAC and TQC an `actor`."""
    return hasattr(model.policy, "action_net")


def output_layer(model: Any) -> Any:
    """Return the last layer of the policy network; for SAC and TQC with gSDE it is followed by a clipping module."""
    return model.policy.action_net if is_on_policy(model) else model.actor.mu


def start_new_episodes(model: Any) -> None:
    """Reset the environment and the noise of gSDE during the training of a model.

    Stable-Baselines3 resets the environment only at the beginning of `learn`, and offers no public method for it later.
    Therefore this function sets the two private attributes in which a model keeps the last observation.
    """
    env = model.get_env()
    model._last_obs = env.reset()
    model._last_episode_starts[:] = True
    if model.use_sde:
        (model.policy if is_on_policy(model) else model.actor).reset_noise(env.num_envs)


def read_zip(path: Path) -> Any:
    """Load a model from a file saved by PPO, SAC or TQC. Loading executes code that is in the file.

    Raises:
        ValueError: If `path` is not such a file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            module = json.loads(archive.read("data"))["policy_class"]["__module__"]
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(f"{path} is not a model saved by Stable-Baselines3: {error}") from error
    name = next((name for name in ("sac", "tqc") if f".{name}." in module), "ppo")
    try:
        return algorithm_class(name).load(path, device="cpu")
    except ImportError as error:
        raise ValueError(f"{path} needs a package that is not installed: {error}") from error
    except (TypeError, KeyError, ValueError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path} is not a model of PPO, SAC or TQC: {error}") from error
