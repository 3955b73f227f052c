"""Create models from training settings: of APG, and of the algorithms of Stable-Baselines3 and sb3-contrib.

Training can start from the network of a learned policy, `start_from`.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from quadpend_gym.tasks.observation import FULL
from quadpend_train.common.text import brief
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.policies.from_sb3 import export
from quadpend_train.policies.loading import load_policy
from quadpend_train.policies.mlp_policy import MlpPolicy, check_interface
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs, algorithm_class, linear_layers
from quadpend_train.training.apg import APG, check_apg
from quadpend_train.training.arguments import as_python, linear_schedule
from quadpend_train.training.environment import observed_scenarios
from quadpend_train.training.settings import ALONE, TrainSettings

# Fields of a card that must be the same
_COMPARED = "activation", "squashed", "bound", "normalization", "input_scales", "hybrid"


def make_model(settings: TrainSettings, env: SB3VecEnv, folder: Path | None) -> Any:
    """Return an untrained model, which writes TensorBoard's event files to the folder, if there is one."""
    is_apg = settings.algo == "apg"
    kind = APG if is_apg else algorithm_class(settings.algo)
    arguments = _apg(settings) if is_apg else as_python(settings.arguments)
    if settings.input_scales:
        arguments["policy_kwargs"] = {
            **arguments.get("policy_kwargs", {}),
            "features_extractor_class": MultiScaleInputs,
            "features_extractor_kwargs": {"scales": settings.input_scales},
        }
    log = None if folder is None else str(folder)
    try:
        model = kind("MlpPolicy", env, tensorboard_log=log, seed=settings.seed, device="cpu", **arguments)
    except AssertionError as error:  # Stable-Baselines3 checks the action space and some arguments this way
        raise ValueError(f"algo {settings.algo!r} refuses its environment or its arguments: {error}") from error
    if settings.hybrid.mode not in ALONE:  # a hybrid starts close to its base controller
        layer = linear_layers(model)[-1]
        with torch.no_grad():
            layer.weight *= 0.1
            layer.bias.zero_()
            if settings.hybrid.baseline_relative_reward and hasattr(model.policy, "value_net"):
                model.policy.value_net.weight.zero_()  # the base controller's return is 0
    return model


def _apg(settings: TrainSettings) -> dict[str, Any]:
    check_apg(settings)
    apg = settings.apg
    return {
        "scenarios": observed_scenarios(settings),
        "apg": apg,
        "learning_rate": linear_schedule(apg.learning_rate, apg.final_learning_rate),
        "policy_kwargs": {"net_arch": list(apg.net_arch), "activation_fn": ACTIVATION_MODULES[apg.activation_fn]},
    }


def load_model(settings: TrainSettings, env: SB3VecEnv, path: Path) -> Any:
    """Return a model from a file that `save` wrote. Except for APG this executes code that is in the file."""
    if settings.algo != "apg":
        return algorithm_class(settings.algo).load(path, env=env, device="cpu")
    model = make_model(settings, env, path.parent)
    model.restore(path)
    return model


def load_actor(model: Any, settings: TrainSettings) -> None:
    """Copy the network of the policy `start_from` to the actor of a model."""
    policy = load_policy(settings.start_from)
    if not isinstance(policy, MlpPolicy):
        raise ValueError(f"start_from must be a learned policy with a feedforward network, not {settings.start_from}")
    hybrid = settings.hybrid
    wider = linear_layers(model)[0].in_features
    plain = policy.hybrid is None and policy.layouts == (FULL,) and len(policy.layers[0][0]) < wider
    if plain and hybrid.base_controller and hybrid.mode == "estimate_only" and not hybrid.deviations:
        policy = _with_inputs(policy, wider, settings.policy_interface())
    try:
        check_interface(policy.card, settings.scenarios[0].simulation)
    except ValueError as error:
        raise ValueError(f"start_from {settings.start_from}: {error}") from error
    own, expected = _compared(policy), _compared(export(model, **settings.policy_interface()))
    for field, value in own.items():
        if value != expected[field]:
            raise ValueError(
                f"start_from {settings.start_from} has {field} {brief(repr(value))}, but the settings have"
                f" {brief(repr(expected[field]))}"
            )
    with torch.no_grad():
        for layer, (weights, biases) in zip(linear_layers(model), policy.layers, strict=True):
            layer.weight.copy_(torch.as_tensor(weights.T))
            layer.bias.copy_(torch.as_tensor(biases))


def _with_inputs(policy: MlpPolicy, inputs: int, interface: dict[str, Any]) -> MlpPolicy:
    """Return a policy with further inputs, which have no weight, behind its own."""
    (weights, biases), *others = policy.layers
    more = np.zeros((inputs - len(weights), len(biases)), np.float32)
    return MlpPolicy([(np.concatenate([weights, more]), biases), *others], policy.card | interface)


def _compared(policy: MlpPolicy) -> dict[str, Any]:
    """Return what must be the same in two policies."""
    widths = [len(policy.layers[0][0]), *(len(biases) for _, biases in policy.layers)]
    return {name: policy.card.get(name) for name in _COMPARED} | {"widths": widths}
