"""Policies from models of Stable-Baselines3: exported to an `MlpPolicy`, or run as they are."""

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_train.policies.mlp_policy import FORMAT, OBSERVATION_SIZES, PLAIN_INTERFACE, MlpPolicy
from quadpend_train.policies.normalization import (
    LOST,
    Normalization,
    from_vec_normalize,
    statistics_file,
    was_normalized,
)
from quadpend_train.policies.sb3_models import actor_modules, read_zip
from quadpend_train.policies.torch_policy import read_layers

_TOLERANCE = 1e-5  # of a component of the action: torch and numpy sum float32 numbers in different orders


def export(model: Any, vec_normalize: Any = None, **card: Any) -> MlpPolicy:
    """Return the policy of a model, without its critic and its optimizer.

    Args:
        model: A model with a feedforward network, such as PPO, A2C, TRPO, SAC, TQC, TD3, DDPG or ARS with `MlpPolicy`.
        vec_normalize: The `VecNormalize` with which the model was trained, or the path of the file (.pkl) to which it
            was saved. Its normalisation of observations becomes part of the policy. None: that of the model's
            environment, if it has one. Loading such a file executes code that is in it.
        card: Further entries of the card. The default of the entries in
            `quadpend_train.policies.mlp_policy.PLAIN_INTERFACE` is a policy whose only input is the latest observation.

    Raises:
        ValueError: If the policy is not a feedforward network, its number of inputs is not the one that the card
            implies, or it was trained with normalised observations whose statistics are missing.
    """
    if not isinstance(model.observation_space, spaces.Box) or len(model.observation_space.shape) != 1:
        raise ValueError(f"{_name(model)} cannot be exported: it observes {_described(model.observation_space)}")
    if hasattr(model.policy, "lstm_actor"):
        raise ValueError(f"{_name(model)} cannot be exported: it has a memory (LSTM), and a policy file has none")
    layers, fields = read_layers(actor_modules(model))
    normalization = _normalization(model, vec_normalize)
    if normalization is not None:
        fields["normalization"] = normalization.as_data()
    policy = MlpPolicy(layers, {"format": FORMAT, **fields, **PLAIN_INTERFACE, **card})
    inputs = np.random.default_rng(0).normal(size=(64, *model.observation_space.shape)).astype(np.float32)
    expected, _ = model.predict(inputs if normalization is None else normalization.apply(inputs), deterministic=True)
    if not np.allclose(policy.forward(inputs), expected, atol=_TOLERANCE):
        raise ValueError("the actions of the model differ from those of its policy network, so it cannot be exported")
    return policy


def export_zip(path: str | Path, vec_normalize: Any = None, **card: Any) -> MlpPolicy:
    """Return the policy of a saved model; its only input must be the latest observation.

    Loading a model executes code that is in its file: export only files whose source you trust.

    Args:
        path: The file (.zip).
        vec_normalize: As for `export`. None: the file that RL Baselines3 Zoo saves with the model, if the model needs
            it and it is there, see `quadpend_train.policies.normalization.statistics_file`.
        card: Further entries of the card.

    Raises:
        ValueError: If `path` is not such a file, or `export` refuses the model.
    """
    model = read_zip(Path(path))
    try:
        return export(model, _statistics(model, Path(path), vec_normalize), **card)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


class ModelPolicy:
    """A model of Stable-Baselines3 as a policy that is run as it is, for models that cannot be exported.

    The memory of a recurrent model is the state of its LSTM.

    Args:
        model: A model of any algorithm that observes 36 or 27 numbers and acts in [−1, 1]⁴.
        vec_normalize: As for `export`.

    Attributes:
        model: The model.
        observation_sizes: The size of the observations that the model accepts, 36 or 27.

    Raises:
        ValueError: If the model has other observations or actions.
    """

    def __init__(self, model: Any, vec_normalize: Any = None) -> None:
        """Check the spaces of the model."""
        observation, action = model.observation_space, model.action_space
        if observation.shape not in [(size,) for size in OBSERVATION_SIZES]:
            raise ValueError(
                f"{_name(model)} observes {_described(observation)}; a policy observes"
                f" {' or '.join(map(str, OBSERVATION_SIZES))} numbers"
            )
        unit = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        if action != unit:
            raise ValueError(f"{_name(model)} acts in {_described(action)}; a policy acts in {_described(unit)}")
        self.model = model
        self.observation_sizes = observation.shape
        self._normalization = _normalization(model, vec_normalize)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and the memory; see `quadpend_baselines.Policy.predict`."""
        observation = np.asarray(observation, np.float32)
        if self._normalization is not None:
            observation = self._normalization.apply(observation)
        action, memory = self.model.predict(observation, state, episode_start, deterministic)
        return action, memory


def policy_from_model(model: Any, vec_normalize: Any = None) -> MlpPolicy | ModelPolicy:
    """Return the policy of a model: exported if possible, else run as it is.

    Args:
        model: A model of any algorithm of Stable-Baselines3 or sb3-contrib that observes 36 or 27 numbers and acts in
            [−1, 1]⁴.
        vec_normalize: As for `export`.

    Raises:
        ValueError: If the model has other observations or actions, or was trained with normalised observations whose
            statistics are missing.
    """
    policy = ModelPolicy(model, vec_normalize)
    try:
        return export(model, vec_normalize)
    except ValueError:
        return policy


def policy_from_zip(path: Path) -> MlpPolicy | ModelPolicy:
    """Return the policy of a saved model, see `policy_from_model`. Loading a model executes code that is in its file.

    Args:
        path: The file (.zip). The statistics of `VecNormalize` are found as by `export_zip`.

    Raises:
        ValueError: If `path` is not such a file, or `policy_from_model` refuses the model.
    """
    model = read_zip(path)
    try:
        return policy_from_model(model, _statistics(model, path, None))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _statistics(model: Any, path: Path, vec_normalize: Any) -> Any:
    """Return the given statistics, or those beside the model's file if the model needs them."""
    if vec_normalize is None and was_normalized(model):
        return statistics_file(path)
    return vec_normalize


def _normalization(model: Any, vec_normalize: Any) -> Normalization | None:
    if vec_normalize is None:
        vec_normalize = model.get_vec_normalize_env()
    if vec_normalize is not None:
        return from_vec_normalize(vec_normalize, model.observation_space.shape[0])
    if was_normalized(model):
        raise ValueError(LOST)
    return None


def _name(model: Any) -> str:
    return f"{type(model).__name__} with {type(model.policy).__name__}"


def _described(space: spaces.Space[Any]) -> str:
    """Return a short description of a space without line breaks."""
    if isinstance(space, spaces.Box):
        return f"numbers of shape {space.shape} from {space.low.min():g} to {space.high.max():g}"
    return " ".join(str(space).split())
