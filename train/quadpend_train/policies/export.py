"""Policies from models of Stable-Baselines3 and torch modules: exported to an `MlpPolicy`, or run as they are."""

from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from gymnasium import spaces

from quadpend_baselines import Policy
from quadpend_gym import read_observation
from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.history import History, histories_of
from quadpend_train.policies.mlp_policy import FORMAT, PLAIN_INTERFACE, MlpPolicy
from quadpend_train.policies.normalization import Normalization, from_vec_normalize, statistics_file
from quadpend_train.policies.sb3_models import ACTIVATION_MODULES, MultiScaleInputs, actor_modules, read_zip

_TOLERANCE = 1e-5  # of a component of the action: torch and numpy sum float32 numbers in different orders
_IDENTITIES = (torch.nn.Identity, torch.nn.Dropout, torch.nn.Flatten)  # in evaluation, for one vector per row
_LENGTH_ERROR = 0.1  # the length of an observed direction differs from 1 by less, also with noisy sensors
_Made = TypeVar("_Made", bound=Policy)


def export(model: Any, vec_normalize: Any = None, **card: Any) -> MlpPolicy:
    """Return the policy of a model, without its critic and its optimizer.

    Args:
        model: A model with a feedforward network, such as PPO, A2C, TRPO, SAC, TQC, TD3, DDPG or ARS with `MlpPolicy`.
        vec_normalize: The `VecNormalize` with which the model was trained, or the path of the file (.pkl) to which it
            was saved. Its normalisation of observations becomes part of the policy. None: that of the model's
            environment, if it has one. Loading such a file executes code that is in it.
        card: Further entries of the card, such as ``history=4``. The default is a policy that observes what the model
            observes, see `find_history`, without a hybrid.
    """
    if "history" not in card:
        history = find_history(model)
        card = {"history": history.observations, "history_actions": history.actions, **card}
    layers, fields = read_layers(actor_modules(model))
    normalization = normalization_of(model, vec_normalize)
    if normalization is not None:
        fields["normalization"] = asdict(normalization)
    policy = MlpPolicy(layers, {"format": FORMAT, **fields, **PLAIN_INTERFACE, **card})
    inputs = np.random.default_rng(0).normal(size=(64, *model.observation_space.shape)).astype(np.float32)
    expected, _ = model.predict(inputs if normalization is None else normalization.apply(inputs), deterministic=True)
    if not np.allclose(policy.forward(inputs), expected, atol=_TOLERANCE):
        raise ValueError("the actions of the model differ from those of its policy network, so it cannot be exported")
    return policy


def export_zip(path: str | Path, vec_normalize: Any = None, **card: Any) -> MlpPolicy:
    """Return the policy of a saved model (.zip), see `export`. Loading a model executes code that is in its file.

    Without `vec_normalize`, the file that RL Baselines3 Zoo saves with the model is used, if the model needs it and it
    is there, see `statistics_file`.
    """
    return from_zip(Path(path), vec_normalize, partial(export, **card))


def from_zip(path: Path, vec_normalize: Any, convert: Callable[[Any, Any], _Made]) -> _Made:
    """Return what a function makes of a saved model and of its `VecNormalize`, see `export_zip`."""
    model = read_zip(path)
    if vec_normalize is None and _was_normalized(model):
        vec_normalize = statistics_file(path)
    try:
        return convert(model, vec_normalize)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def policy_from_torch(module: torch.nn.Module) -> MlpPolicy:
    """Return a policy that acts like a `torch.nn.Sequential`, and can be saved to a policy file.

    It has linear layers with relu, tanh or elu between them. Without a tanh at the end, actions are clipped to [−1, 1].
    """
    layers, fields = read_layers([deepcopy(module).eval()])
    return MlpPolicy(layers, {"format": FORMAT, **fields, **PLAIN_INTERFACE})


def find_history(model: Any) -> History:
    """Return the history that a model observes, from the size of its observation space."""
    space = model.observation_space
    found = histories_of(space.shape[0]) if isinstance(space, spaces.Box) and len(space.shape) == 1 else []
    if len(found) != 1:
        raise ValueError(
            f"{type(model).__name__} with {type(model.policy).__name__} observes {' '.join(str(space).split())}; a"
            " policy observes 36 or 27 numbers, or a history of them with at most 8 actions; where several fit, export"
            " it with the option history (quadpend export --history)"
        )
    return found[0]


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
    if found and isinstance(limit := found[-1], torch.nn.Hardtanh) and limit.min_val == -limit.max_val:
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
    if vec_normalize is not None:
        return from_vec_normalize(vec_normalize, model.observation_space.shape[0])
    if _was_normalized(model):
        raise ValueError(
            "the model was trained with normalised observations, and the statistics of VecNormalize are missing: give"
            " them with --vec-normalize (vec_normalize=… in Python)"
        )
    return None


def _was_normalized(model: Any) -> bool:
    """Return whether a model was trained with normalised observations, according to the observations saved in it.

    `VecNormalize` leaves an original observation in a model. The direction of the pendulum has the length 1 in original
    observations, but not in normalised ones.
    """
    original, last = model._last_original_obs, model._last_obs
    if original is None or last is None or np.ndim(last) != 2:
        return False
    firsts = [[rows[:, : history.size] for rows in (original, last)] for history in histories_of(last.shape[1])]
    return any(_has_unit_directions(before) and not _has_unit_directions(after) for before, after in firsts)


def _has_unit_directions(observation: Any) -> bool:
    length = np.linalg.norm(read_observation(observation, "direction"), axis=1)
    return bool(np.median(np.abs(length - 1.0)) < _LENGTH_ERROR)
