"""Create models of PPO, SAC, TQC and APG from training settings."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from quadpend_gym.scenarios import expand_sets, find_scenario
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs, algorithm_class, output_layer
from quadpend_train.training.apg import APG, check_apg
from quadpend_train.training.settings import TrainSettings


def make_model(settings: TrainSettings, env: SB3VecEnv, folder: Path | None) -> Any:
    """Return an untrained model.

    Args:
        settings: The training settings.
        env: The training environment.
        folder: The folder for TensorBoard's event files; None writes no event files.
    """
    special = {"ppo": _ppo, "apg": _apg}.get(settings.algo, _sac)(settings)
    policy = special.pop("policy_kwargs", {})
    if settings.input_scales:
        policy |= {
            "features_extractor_class": MultiScaleInputs,
            "features_extractor_kwargs": {"scales": settings.input_scales},
        }
    kind: Any = APG if settings.algo == "apg" else algorithm_class(settings.algo)
    model = kind(
        "MlpPolicy",
        env,
        learning_rate=_linear_schedule(settings.learning_rate, settings.final_learning_rate),
        gamma=settings.gamma,
        use_sde=settings.sde_sample_freq > 0,
        sde_sample_freq=settings.sde_sample_freq or -1,
        policy_kwargs={
            "net_arch": list(settings.net_arch),
            "activation_fn": ACTIVATION_MODULES[settings.activation_fn],
            **policy,
        },
        tensorboard_log=None if folder is None else str(folder),
        seed=settings.seed,
        device="cpu",
        **special,
    )
    if settings.hybrid.mode != "estimate_only":
        _start_near_zero(model, settings)
    return model


def _ppo(settings: TrainSettings) -> dict[str, Any]:
    return {
        "batch_size": settings.batch_size,
        "n_steps": settings.ppo.n_steps,
        "n_epochs": settings.ppo.n_epochs,
        "gae_lambda": settings.ppo.gae_lambda,
        "clip_range": settings.ppo.clip_range,
        "ent_coef": settings.ppo.ent_coef,
        "policy_kwargs": {"log_std_init": settings.ppo.log_std_init},
    }


def _sac(settings: TrainSettings) -> dict[str, Any]:
    return {
        "batch_size": settings.batch_size,
        "train_freq": (settings.sde_sample_freq or 1, "step"),
        "gradient_steps": settings.sac.gradient_steps * (settings.sde_sample_freq or 1),
        "buffer_size": settings.sac.buffer_size,
        "learning_starts": settings.sac.learning_starts,
        "tau": settings.sac.tau,
        "ent_coef": f"auto_{settings.sac.ent_coef_init}",
        "target_entropy": settings.sac.target_entropy,
    }


def _apg(settings: TrainSettings) -> dict[str, Any]:
    check_apg(settings)
    scenarios = [find_scenario(name) for name in expand_sets(settings.scenarios)]
    return {"scenarios": scenarios, "apg": settings.apg}


def load_model(settings: TrainSettings, env: SB3VecEnv, path: Path) -> Any:
    """Return a model from a file that its method `save` wrote. Except for APG this executes code that is in the file.

    Args:
        settings: The training settings.
        env: The training environment.
        path: The file; events of TensorBoard are written to its folder.
    """
    if settings.algo != "apg":
        return algorithm_class(settings.algo).load(path, env=env, device="cpu")
    model = make_model(settings, env, path.parent)
    model.restore(path)
    return model


def _linear_schedule(initial: float, final: float) -> Callable[[float], float]:
    return lambda progress_remaining: final + (initial - final) * max(progress_remaining, 0.0)


def _start_near_zero(model: Any, settings: TrainSettings) -> None:
    """Scale down the initial actions of a hybrid, so that it starts close to its base controller.

    With a baseline-relative reward, the return of the base controller is 0, so the output of PPO's critic starts at 0.
    """
    with torch.no_grad():
        layer: Any = output_layer(model)
        if isinstance(layer, torch.nn.Sequential):  # with gSDE a clipping module follows the layer
            layer = layer[0]
        layer.weight *= 0.1
        layer.bias.zero_()
        if settings.hybrid.baseline_relative_reward and settings.algo == "ppo":
            model.policy.value_net.weight.zero_()
