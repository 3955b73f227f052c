"""Export the policy of a Stable-Baselines3 model to an `MlpPolicy`: the weights of its network, and a card."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.mlp_policy import FORMAT, PLAIN_INTERFACE, MlpPolicy
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, is_on_policy, output_layer, read_zip

_TOLERANCE = 1e-5  # of a component of the action: torch and numpy sum float32 numbers in different orders


def export(model: Any, **card: Any) -> MlpPolicy:
    """Return the policy of a model, without its critic and its optimizer.

    Args:
        model: PPO, SAC or TQC with an `MlpPolicy`.
        card: Further entries of the card. The default of the entries in
            `quadpend_train.policies.mlp_policy.PLAIN_INTERFACE` is a policy whose only input is the latest observation.

    Raises:
        ValueError: If the policy is not a feedforward network, or its number of inputs is not the one that the card
            implies.
    """
    layers, activation = _network(model)
    entries: dict[str, Any] = {
        "format": FORMAT,
        "activation": activation,
        "squashed": not is_on_policy(model),
        **PLAIN_INTERFACE,
    }
    last = output_layer(model)
    if isinstance(last, torch.nn.Sequential):  # gSDE of SAC and TQC clips the output of the last layer
        clipping: Any = last[1]
        entries["bound"] = float(clipping.max_val)
    policy = MlpPolicy(layers, {**entries, **card})
    inputs = np.random.default_rng(0).normal(size=(64, layers[0][0].shape[0])).astype(np.float32)
    expected, _ = model.predict(inputs, deterministic=True)
    if not np.allclose(policy.forward(inputs), expected, atol=_TOLERANCE):
        raise ValueError("the actions of the model differ from those of its policy network, so it cannot be exported")
    return policy


def export_zip(path: Path, **card: Any) -> MlpPolicy:
    """Return the policy of a model saved by PPO, SAC or TQC; its only input must be the latest observation.

    Loading a model executes code that is in its file: export only files whose source you trust.

    Args:
        path: The file (.zip).
        card: Further entries of the card.

    Raises:
        ValueError: If `path` is not such a file, or its policy is not a feedforward network of an observation.
    """
    return export(read_zip(path), **card)


def _network(model: Any) -> tuple[Sequence[tuple[Floats32, Floats32]], str]:
    """Return the weights and biases of the policy network's layers, and the name of its activation function."""
    policy = model.policy
    hidden = policy.mlp_extractor.policy_net if hasattr(policy, "mlp_extractor") else policy.actor.latent_pi
    last = output_layer(model)
    modules = [*hidden, *(last if isinstance(last, torch.nn.Sequential) else [last])]
    linear = [module for module in modules if isinstance(module, torch.nn.Linear)]
    activations = [module for module in modules if not isinstance(module, torch.nn.Linear | torch.nn.Hardtanh)]
    names = [name for name, kind in ACTIVATION_MODULES.items() if all(type(module) is kind for module in activations)]
    if not names or len(activations) != len(linear) - 1:
        raise ValueError("the policy network must have linear layers with relu, tanh or elu between them")
    layers = [
        (layer.weight.detach().numpy().T.astype(np.float32).copy(), layer.bias.detach().numpy().astype(np.float32))
        for layer in linear
    ]
    return layers, names[0]
