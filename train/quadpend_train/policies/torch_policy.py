"""Policies from torch modules."""

from collections.abc import Iterable, Iterator
from copy import deepcopy
from typing import Any

import numpy as np
import torch

from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.mlp_policy import FORMAT, PLAIN_INTERFACE, MlpPolicy
from quadpend_train.policies.network_policy import NetworkPolicy
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs

_IDENTITIES = (torch.nn.Identity, torch.nn.Dropout, torch.nn.Flatten)  # in evaluation, for one vector per row
Layers = list[tuple[Floats32, Floats32]]


def policy_from_torch(module: torch.nn.Module) -> MlpPolicy | NetworkPolicy:
    """Return a policy that acts like a torch module in evaluation mode; later changes of the module do not change it.

    The module maps observations, shape (n, 36) or (n, 27), to actions, shape (n, 4). Its output is clipped to [−1, 1].
    A `torch.nn.Sequential` of linear layers with relu, tanh or elu between them, and a tanh at the end if wanted,
    becomes an `MlpPolicy`, which can be saved to a policy file. A policy of another module runs the module.

    Args:
        module: The module, for one observation per row.

    Raises:
        ValueError: If the module does not map such observations to four finite numbers.
    """
    module = deepcopy(module).cpu().eval()
    try:
        layers, fields = read_layers([module])
    except ValueError:
        dtype = next((item.dtype for item in module.parameters() if item.is_floating_point()), torch.float32)

        def run(observation: Floats32) -> Any:
            with torch.no_grad():
                return module(torch.as_tensor(observation).to(dtype)).numpy()

        return NetworkPolicy(run, f"the torch module {type(module).__name__}")
    return MlpPolicy(layers, {"format": FORMAT, **fields, **PLAIN_INTERFACE})


def read_layers(modules: Iterable[torch.nn.Module]) -> tuple[Layers, dict[str, Any]]:
    """Return the layers of a feedforward network, and the fields of an `MlpPolicy`'s card that describe the others.

    Args:
        modules: The modules of the network in order. Containers are replaced by their modules.

    Raises:
        ValueError: If the network does not consist of linear layers with one kind of activation function between them,
            optional `MultiScaleInputs` at the beginning, and an optional limit and tanh at the end.
    """
    found = [module for module in _flat(modules) if not isinstance(module, _IDENTITIES)]
    fields: dict[str, Any] = {"activation": "relu", "squashed": bool(found) and type(found[-1]) is torch.nn.Tanh}
    if found and isinstance(first := found[0], MultiScaleInputs):
        fields["input_scales"] = list(first.scales)
        found.pop(0)
    if fields["squashed"]:
        found.pop()
    if found and isinstance(limit := found[-1], torch.nn.Hardtanh) and limit.min_val == -limit.max_val:
        fields["bound"] = float(limit.max_val)
        found.pop()
    linear, activations = found[::2], found[1::2]
    names = [name for name, kind in ACTIVATION_MODULES.items() if all(type(item) is kind for item in activations)]
    wrong = not all(type(item) is torch.nn.Linear for item in linear) or len(linear) != len(activations) + 1
    if wrong or not names or any(getattr(item, "alpha", 1.0) != 1.0 for item in activations):
        raise ValueError("the policy network must have linear layers with relu, tanh or elu between them")
    fields["activation"] = names[0]
    return [_arrays(layer) for layer in linear], fields


def _flat(modules: Iterable[torch.nn.Module]) -> Iterator[torch.nn.Module]:
    for module in modules:
        if type(module) is torch.nn.Sequential:
            yield from _flat(module)
        else:
            yield module


def _arrays(layer: Any) -> tuple[Floats32, Floats32]:
    weights = layer.weight.detach().cpu().numpy().T.astype(np.float32).copy()
    if layer.bias is None:
        return weights, np.zeros(weights.shape[1], np.float32)
    return weights, layer.bias.detach().cpu().numpy().astype(np.float32).copy()
