"""Start training from the network of a learned policy."""

from pathlib import Path
from typing import Any

import torch

from quadpend_train.policies.export import export
from quadpend_train.policies.loading import load_policy, policy_fingerprint
from quadpend_train.policies.mlp_policy import PLAIN_INTERFACE, MlpPolicy, check_interface
from quadpend_train.policies.sb3_models import actor_modules
from quadpend_train.training.settings import TrainSettings

START = "start.npz"  # copy of the policy in the run folder, with which the run resumes
# Fields of a card that must be the same, with their defaults
_COMPARED = dict.fromkeys(("activation", "squashed", "bound", "normalization", "input_scales")) | PLAIN_INTERFACE


def load_actor(model: Any, settings: TrainSettings, copied: Path | None) -> None:
    """Copy the network of the policy `start_from`, or of its copy if that exists, to the actor of a model."""
    name, expected = settings.start_from, export(model, **settings.policy_interface())
    policy = MlpPolicy.load(copied) if copied and copied.is_file() else start_policy(settings)
    _check_commands(policy, settings)
    for field, default in _COMPARED.items():
        if policy.card.get(field, default) != (other := expected.card.get(field, default)):
            raise ValueError(
                f"start_from {name} was trained with VecNormalize, whose statistics a training here cannot continue"
                if field == "normalization"
                else f"start_from {name} has {field} {policy.card.get(field, default)!r}, but the settings have"
                f" {other!r}"
            )
    if _widths(policy) != _widths(expected):
        raise ValueError(
            f"start_from {name} has a network of widths {_widths(policy)}, but the settings have {_widths(expected)}"
        )
    linear = [item for part in actor_modules(model) for item in part.modules() if isinstance(item, torch.nn.Linear)]
    with torch.no_grad():
        for layer, (weights, biases) in zip(linear, policy.layers, strict=True):
            layer.weight.copy_(torch.as_tensor(weights.T))
            layer.bias.copy_(torch.as_tensor(biases))


def start_policy(settings: TrainSettings) -> MlpPolicy:
    """Return the policy `start_from`."""
    policy = load_policy(settings.start_from)
    if not isinstance(policy, MlpPolicy):
        raise ValueError(f"start_from must be a learned policy with a feedforward network, not {settings.start_from}")
    return policy


def _check_commands(policy: MlpPolicy, settings: TrainSettings) -> None:
    """Check that the actions of the policy command what those of the training command."""
    try:
        check_interface(policy.card, next(iter(settings.found().values())).simulation)
    except ValueError as error:
        raise ValueError(f"start_from {settings.start_from}: {error}") from error


def start_provenance(settings: TrainSettings) -> dict[str, Any]:
    """Return the policy `start_from` and the hash of its file, for the provenance of a run; empty without it."""
    name = settings.start_from
    return {"start_from": {"policy": name, "sha256": policy_fingerprint(name)}} if name else {}


def check_reproducible(card: dict[str, Any], name: str) -> None:
    """Check that a training from the card of the policy `name` would give the same weights on the same machine."""
    start = card["provenance"].get("start_from")
    if start and policy_fingerprint(start["policy"]) != start["sha256"]:
        raise ValueError(f"the policy {start['policy']} has changed since the training of {name} started from it")


def _widths(policy: MlpPolicy) -> list[int]:
    return [len(policy.layers[0][0]), *(len(biases) for _, biases in policy.layers)]
