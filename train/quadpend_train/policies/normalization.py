"""Normalisation of observations: that of `VecNormalize` of Stable-Baselines3, as data in the card of a policy."""

import pickle
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.settings import Range, settings
from quadpend_train.common.text import brief

STATISTICS = "vecnormalize.pkl"  # name of the file in the run folders of RL Baselines3 Zoo
_LARGEST = float(np.finfo(np.float32).max)  # a card has no infinity


@settings
class Normalization:
    """The map of an observation o to clip((o − mean) / std, −clip, clip).

    A network cannot contain the clipping, therefore the policy file does.
    """

    mean: tuple[float, ...]
    std: Annotated[tuple[float, ...], Range(1e-30, _LARGEST)]
    clip: Annotated[float, Range(1e-30, _LARGEST)]

    def __post_init__(self) -> None:
        """Keep the arrays."""
        object.__setattr__(self, "_arrays", (np.array(self.mean), np.array(self.std)))

    def apply(self, observation: Floats32) -> Floats32:
        """Return normalised observations of shape (..., m), computed like in `VecNormalize`."""
        mean, std = self._arrays  # type: ignore[attr-defined]
        return np.asarray(np.clip((observation - mean) / std, -self.clip, self.clip), np.float32)

    def as_data(self) -> dict[str, Any]:
        """Return plain data for a policy's card."""
        return {"mean": list(self.mean), "std": list(self.std), "clip": self.clip}


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
        source, path = str(vec_normalize), Path(vec_normalize)
        try:
            vec_normalize = pickle.loads(path.read_bytes())
        except Exception as error:  # a damaged pickle can raise nearly any exception
            raise ValueError(f"{path} is not a file saved by VecNormalize: {brief(error)}") from error
    try:
        if not vec_normalize.norm_obs:
            return None
        statistics = vec_normalize.obs_rms
        mean, std = statistics.mean, np.sqrt(statistics.var + vec_normalize.epsilon)
        clip = min(float(vec_normalize.clip_obs), _LARGEST)
    except AttributeError as error:
        kind = type(vec_normalize).__name__
        raise ValueError(f"{source} must be a VecNormalize of Stable-Baselines3 for vectors, not {kind}") from error
    if mean.shape != (size,):
        raise ValueError(f"{source} must have statistics of {size} numbers, the inputs of the policy, not {mean.shape}")
    return Normalization(mean, std, clip)


def statistics_file(model: Path) -> Path | None:
    """Return the file with the statistics of a model in a run folder of RL Baselines3 Zoo; None if there is none.

    Args:
        model: File (.zip) of the model. The Zoo saves the statistics in a folder next to it.
    """
    found = [path for path in (model.parent / STATISTICS, *model.parent.glob(f"*/{STATISTICS}")) if path.is_file()]
    return found[0] if len(found) == 1 else None
