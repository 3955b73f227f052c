"""PPO, SAC and TQC of Stable-Baselines3 and sb3-contrib, made from settings."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from train.sb3_vec_env import SB3VecEnv
from train.settings import TrainSettings

ACTIVATIONS = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh, "elu": torch.nn.ELU}


def algorithm(name: str) -> Any:
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


def make_model(settings: TrainSettings, env: SB3VecEnv, folder: Path | None) -> Any:
    """An untrained model; with a `folder`, TensorBoard's events go there."""
    own = _ppo(settings) if settings.algo == "ppo" else _sac(settings)
    policy = own.pop("policy_kwargs", {})
    model = algorithm(settings.algo)(
        "MlpPolicy",
        env,
        learning_rate=_falling(settings.learning_rate, settings.final_learning_rate),
        batch_size=settings.batch_size,
        gamma=settings.discount,
        use_sde=settings.exploration_steps > 0,
        sde_sample_freq=settings.exploration_steps or -1,
        policy_kwargs={
            "net_arch": list(settings.hidden),
            "activation_fn": ACTIVATIONS[settings.activation],
            **policy,
        },
        tensorboard_log=None if folder is None else str(folder),
        seed=settings.seed,
        device="cpu",
        **own,
    )
    if settings.steers != "alone":
        _begin_at_zero(model, settings)
    return model


def _ppo(settings: TrainSettings) -> dict[str, Any]:
    return {
        "n_steps": settings.ppo.rollout_steps,
        "n_epochs": settings.ppo.epochs,
        "gae_lambda": settings.ppo.gae_lambda,
        "clip_range": settings.ppo.clip_range,
        "ent_coef": settings.ppo.entropy_coefficient,
        "policy_kwargs": {"log_std_init": settings.ppo.initial_log_std},
    }


def _sac(settings: TrainSettings) -> dict[str, Any]:
    return {
        "train_freq": (settings.exploration_steps or 1, "step"),
        "gradient_steps": settings.sac.gradient_steps * (settings.exploration_steps or 1),
        "buffer_size": settings.sac.buffer_size,
        "learning_starts": settings.sac.learning_starts,
        "tau": settings.sac.tau,
        "ent_coef": f"auto_{settings.sac.initial_entropy_coefficient}",
        "target_entropy": settings.sac.target_entropy,
    }


def _falling(first: float, last: float) -> Callable[[float], float]:
    return lambda remaining: last + (first - last) * max(remaining, 0.0)


def output_layer(model: Any) -> Any:
    """The last layer of the policy's network."""
    return model.policy.action_net if hasattr(model.policy, "action_net") else model.actor.mu


def _begin_at_zero(model: Any, settings: TrainSettings) -> None:
    """Steer nothing at the beginning, and expect nothing more than the companion earns."""
    with torch.no_grad():
        layer: Any = output_layer(model)
        if isinstance(layer, torch.nn.Sequential):  # of a state-dependent exploration
            layer = layer[0]
        layer.weight *= 0.1
        layer.bias.zero_()
        if settings.paired and settings.algo == "ppo":
            model.policy.value_net.weight.zero_()


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
        return algorithm(name).load(path, device="cpu")
    except ImportError as error:
        raise ValueError(f"{path} was saved with a package that is not installed: {error}") from error
    except (TypeError, KeyError, ValueError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path} is no model of PPO, SAC or TQC: {error}") from error
