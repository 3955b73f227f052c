"""Start training from the network of a learned policy."""

from pathlib import Path
from typing import Any

import torch

from quadpend_train.common.text import brief
from quadpend_train.policies.export import export
from quadpend_train.policies.loading import load_policy
from quadpend_train.policies.mlp_policy import PLAIN_INTERFACE, MlpPolicy, check_interface
from quadpend_train.policies.sb3_models import linear_layers
from quadpend_train.training.settings import TrainSettings

# Fields of a card that must be the same, with their defaults
_COMPARED = dict.fromkeys(("activation", "squashed", "bound", "normalization", "input_scales")) | PLAIN_INTERFACE


def load_actor(model: Any, settings: TrainSettings, copied: Path | None) -> None:
    """Copy the network of the policy `start_from`, or of its copy if that exists, to the actor of a model."""
    policy = MlpPolicy.load(copied) if copied and copied.is_file() else start_policy(settings)
    try:
        check_interface(policy.card, next(iter(settings.found().values())).simulation)
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


def _compared(policy: MlpPolicy) -> dict[str, Any]:
    """Return what must be the same in two policies."""
    widths = [len(policy.layers[0][0]), *(len(biases) for _, biases in policy.layers)]
    return {name: policy.card.get(name, default) for name, default in _COMPARED.items()} | {"widths": widths}


def start_policy(settings: TrainSettings) -> MlpPolicy:
    """Return the policy `start_from`."""
    policy = load_policy(settings.start_from)
    if not isinstance(policy, MlpPolicy):
        raise ValueError(f"start_from must be a learned policy with a feedforward network, not {settings.start_from}")
    return policy
