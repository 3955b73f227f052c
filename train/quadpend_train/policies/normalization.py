"""Normalisation of observations: that of `VecNormalize` of Stable-Baselines3, as data in the card of a policy."""

import pickle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym import read_observation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.validation import as_vector, check_positive
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE
from quadpend_train.common.text import brief

STATISTICS = "vecnormalize.pkl"  # name of the file in the run folders of RL Baselines3 Zoo
_LENGTH_ERROR = 0.1  # the length of an observed direction differs from 1 by less, also with noisy sensors
LOST = (
    "the model was trained with normalised observations, and the statistics of VecNormalize are missing: give them"
    " with --vec-normalize (vec_normalize=… in Python)"
)


class Normalization(NamedTuple):
    """The map of an observation o to clip((o − mean) / std, −clip, clip).

    A network cannot contain the clipping, therefore the policy file does.
    """

    mean: Floats  # (m,)
    std: Floats  # (m,)
    clip: float

    def apply(self, observation: Floats32) -> Floats32:
        """Return normalised observations of shape (..., m), computed like in `VecNormalize`."""
        return np.clip((observation - self.mean) / self.std, -self.clip, self.clip).astype(np.float32)

    def as_data(self) -> dict[str, Any]:
        """Return plain data for a policy's card."""
        return {"mean": self.mean.tolist(), "std": self.std.tolist(), "clip": self.clip}


def normalization_from_data(data: Any, size: int) -> Normalization:
    """Return the normalisation that plain data describe.

    Args:
        data: A mapping with the fields of `Normalization`.
        size: Number of inputs of the network.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If `data` is not such a mapping, or an array has the wrong size or is not finite.
    """
    if not isinstance(data, dict) or data.keys() != set(Normalization._fields):
        raise ValueError(f"normalization must have {', '.join(Normalization._fields)}, not {data!r}")
    mean, std = (np.array(as_vector(data[name], size, f"normalization.{name}")) for name in ("mean", "std"))
    if not (std > 0.0).all():
        raise ValueError("normalization.std must be above zero")
    return Normalization(mean, std, check_positive(data["clip"], "normalization.clip"))


def from_vec_normalize(vec_normalize: Any, size: int) -> Normalization | None:
    """Return the normalisation of a `VecNormalize`; None if it normalises rewards only.

    Args:
        vec_normalize: A `VecNormalize`, or the path of the file (.pkl) to which it was saved. Loading such a file
            executes code that is in it.
        size: Number of inputs of the network.

    Raises:
        ValueError: If `vec_normalize` is neither, or has statistics of another number of inputs.
    """
    source = "vec_normalize"
    if isinstance(vec_normalize, str | Path):
        source, vec_normalize = str(vec_normalize), _read_statistics(Path(vec_normalize))
    if not hasattr(vec_normalize, "norm_obs"):
        raise ValueError(f"{source} must be a VecNormalize of Stable-Baselines3, not {type(vec_normalize).__name__}")
    if not vec_normalize.norm_obs:
        return None
    shape = getattr(getattr(vec_normalize.obs_rms, "mean", None), "shape", "of a dictionary")
    if shape != (size,):
        raise ValueError(f"{source} must have statistics of {size} numbers, the inputs of the policy, not {shape}")
    std = np.sqrt(vec_normalize.obs_rms.var + vec_normalize.epsilon)
    clip = min(float(vec_normalize.clip_obs), float(np.finfo(np.float32).max))  # a card has no infinity
    return Normalization(vec_normalize.obs_rms.mean.copy(), std, clip)


def statistics_file(model: Path) -> Path | None:
    """Return the file with the statistics of a model in a run folder of RL Baselines3 Zoo; None if there is none.

    Args:
        model: File (.zip) of the model. The Zoo saves the statistics in a folder next to it.
    """
    found = [path for path in (model.parent / STATISTICS, *model.parent.glob(f"*/{STATISTICS}")) if path.is_file()]
    return found[0] if len(found) == 1 else None


def was_normalized(model: Any) -> bool:
    """Return whether a model was trained with normalised observations, according to the observations saved in it.

    `VecNormalize` leaves an original observation in a model. The direction of the pendulum has the length 1 in original
    observations, but not in normalised ones.

    Args:
        model: A model of Stable-Baselines3.
    """
    last, original = model._last_obs, model._last_original_obs
    return original is not None and _has_unit_directions(original) and not _has_unit_directions(last)


def _has_unit_directions(observation: Any) -> bool:
    """Return whether observations, shape (n, m), have directions of length 1; True if they have other sizes."""
    if np.ndim(observation) != 2 or np.shape(observation)[1] not in (OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE):
        return True
    length = np.linalg.norm(read_observation(observation, "direction"), axis=1)
    return bool(np.median(np.abs(length - 1.0)) < _LENGTH_ERROR)


def _read_statistics(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            return pickle.load(file)
    except Exception as error:  # a damaged pickle can raise nearly any exception
        raise ValueError(f"{path} is not a file saved by VecNormalize: {brief(error)}") from error
