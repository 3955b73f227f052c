"""Policies from models of Stable-Baselines3: exported to an `MlpPolicy`, or run as they are."""

import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from quadpend_baselines import Policy
from quadpend_baselines.hybrid import HistoryOnly
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.envs.spaces import meaning_of
from quadpend_gym.tasks.observation import PRESETS
from quadpend_train.policies.mlp_policy import FORMAT, MlpPolicy
from quadpend_train.policies.normalization import STATISTICS, Normalization, from_vec_normalize, statistics_files
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs, actor_modules, read_zip

_TOLERANCE = 1e-5  # of a component of the action: torch and numpy sum float32 numbers in different orders
_IDENTITIES = (torch.nn.Identity, torch.nn.Dropout, torch.nn.Flatten)  # in evaluation, for one vector per row
_Made = TypeVar("_Made", bound=Policy)


def export(model: Any, vec_normalize: Any = None, **card: Any) -> MlpPolicy:
    """Return the policy of a model, without its critic and its optimizer.

    Args:
        model: A model with a feedforward network, such as PPO, A2C, TRPO, SAC, TQC, TD3, DDPG or ARS with `MlpPolicy`.
        vec_normalize: The `VecNormalize` with which the model was trained, or the path of the file (.pkl) to which it
            was saved. Its normalisation of observations becomes part of the policy. None: that of the model's
            environment, if it has one. Loading such a file executes code that is in it.
        card: Further entries of the card, such as a hybrid.
    """
    layers, fields = read_layers(actor_modules(model))
    if not card.get("hybrid"):
        fields |= trained_for(model)
        if history := meaning_of(model.observation_space).get("history"):
            card["hybrid"] = {"kind": HistoryOnly.kind, "observations": history[0], "actions": history[1]}
    normalization = normalization_of(model, vec_normalize)
    if normalization is not None:
        fields["normalization"] = asdict(normalization)
    policy = MlpPolicy(layers, {"format": FORMAT, **fields, "hybrid": None, **card})
    inputs = np.random.default_rng(0).normal(size=(64, *model.observation_space.shape)).astype(np.float32)
    expected, _ = model.predict(inputs if normalization is None else normalization.apply(inputs), deterministic=True)
    if not np.allclose(policy.forward(inputs), expected, atol=_TOLERANCE):
        raise ValueError("the actions of the model differ from those of its policy network, so it cannot be exported")
    return policy


def export_zip(path: str | Path, vec_normalize: Any = None, **card: Any) -> MlpPolicy:
    """Return the policy of a saved model (.zip), see `export`. Loading a model executes code that is in its file.

    Without `vec_normalize`, the statistics are those of the file of `statistics_files`.
    """
    return from_zip(Path(path), vec_normalize, partial(export, **card))


def from_zip(path: Path, vec_normalize: Any, convert: Callable[[Any, Any], _Made]) -> _Made:
    """Return what a function makes of a saved model and of its `VecNormalize`, see `export_zip`."""
    model = read_zip(path)
    try:
        return convert(model, vec_normalize or _statistics(path, model))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _statistics(path: Path, model: Any) -> Path | None:
    """Return the file of the statistics with which a saved model was trained, and say what is applied.

    `_last_original_obs` are the observations before the normalisation. An on-policy algorithm stores them only with
    `VecNormalize`, others always, so their models do not tell.
    """
    found = statistics_files(path)
    names = " and ".join(map(str, found))
    learned, stored = (getattr(model, f"_last_{name}obs", None) is not None for name in ("", "original_"))
    tells = learned and isinstance(model, OnPolicyAlgorithm)
    if len(found) > 1 and (stored or not tells):
        raise ValueError(f"the statistics of VecNormalize are in {names}: keep one of them")
    if tells and stored and not found:
        message = f"was trained with VecNormalize; if that normalised observations, put {STATISTICS[0]} beside it"
    elif tells and found and not stored:
        message = f"was trained without VecNormalize: {names} is not applied"
        found = []
    elif found:
        message = f"observations are normalised by {names}" + (
            "" if tells else "; if it was trained without, move that away"
        )
    else:
        return None
    print(f"{path}: {message}.", file=sys.stderr)
    return found[0] if found else None


def trained_for(model: Any) -> dict[str, Any]:
    """Return fields, interface and vehicle of a model's training, as on a card; nothing if the model does not say it.

    A model from elsewhere, or of an older version, reads a preset if it has as many inputs.

    Raises:
        ValueError: If the model is a part of a hybrid, which does not fly alone.
    """
    found = meaning_of(model.action_space)
    if "hybrid" in found:
        raise ValueError(f"the model is the network of a hybrid ({found['hybrid']}): give the policy file of its run")
    observed, presets = meaning_of(model.observation_space), {(layout.size,): layout for layout in PRESETS.values()}
    layout = observed.get("layout") or presets.get(model.observation_space.shape)
    return found if layout is None else {**found, "observation": list(layout)}


def read_layers(modules: Iterable[torch.nn.Module]) -> tuple[list[tuple[Floats32, Floats32]], dict[str, Any]]:
    """Return the linear layers of a feedforward network, and the fields of an `MlpPolicy`'s card about the rest.

    These are one kind of activation function between the layers, optional `MultiScaleInputs` at the beginning, and an
    optional limit and tanh at the end. Containers are replaced by their modules.
    """
    found = [module for module in _flat(modules) if not isinstance(module, _IDENTITIES)]
    fields: dict[str, Any] = {"squashed": bool(found) and type(found[-1]) is torch.nn.Tanh}
    if found and isinstance(first := found[0], MultiScaleInputs):
        fields["input_scales"] = list(first.scales)
        found.pop(0)
    if fields["squashed"]:
        found.pop()
    if found and isinstance(limit := found[-1], torch.nn.Hardtanh) and limit.min_val == -limit.max_val:  # SAC with gSDE
        fields["bound"] = float(limit.max_val)
        found.pop()
    linear: list[Any] = found[::2]
    activations = found[1::2]
    names = [name for name, kind in ACTIVATION_MODULES.items() if all(type(item) is kind for item in activations)]
    wrong = not all(type(item) is torch.nn.Linear for item in linear) or len(linear) != len(activations) + 1
    if wrong or not names or any(getattr(item, "alpha", 1.0) != 1.0 for item in activations):
        raise ValueError("the policy network must have linear layers with relu, tanh or elu between them")
    layers = []
    for layer in linear:
        weights, biases = layer.weight.detach().cpu().numpy().T.copy(), layer.bias
        given = np.zeros(weights.shape[1]) if biases is None else biases.detach().cpu().numpy()
        layers.append((weights.astype(np.float32), given.astype(np.float32)))
    return layers, {**fields, "activation": names[0]}


def _flat(modules: Iterable[torch.nn.Module]) -> Iterator[torch.nn.Module]:
    for module in modules:
        if type(module) is torch.nn.Sequential:
            yield from _flat(module)
        else:
            yield module


def normalization_of(model: Any, vec_normalize: Any) -> Normalization | None:
    """Return the normalisation of the observations of a model, see `export`."""
    if vec_normalize is None:
        vec_normalize = model.get_vec_normalize_env()
    return None if vec_normalize is None else from_vec_normalize(vec_normalize, model.observation_space.shape[0])
