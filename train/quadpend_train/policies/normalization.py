"""Normalisation of observations: that of `VecNormalize` of Stable-Baselines3, as data in the card of a policy."""

import pickle
import re
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.settings import Range, settings
from quadpend_train.common.text import brief

STATISTICS = "vec_normalize.pkl", "vecnormalize.pkl"  # of Stable-Baselines3's pages and Hugging Face, and of the Zoo
_LARGEST = float(np.finfo(np.float32).max)  # a card has no infinity


@settings
class Normalization:
    """The map of an observation o to clip((o − mean) / std, −clip, clip), which a network cannot contain."""

    mean: tuple[float, ...]
    std: Annotated[tuple[float, ...], Range(1e-30, _LARGEST)]
    clip: Annotated[float, Range(1e-30, _LARGEST)]

    def apply(self, observation: Floats32) -> Floats32:
        """Return normalised observations of shape (..., m), computed like in `VecNormalize`."""
        scaled = (observation - np.array(self.mean)) / np.array(self.std)
        return np.asarray(np.clip(scaled, -self.clip, self.clip), np.float32)


def from_vec_normalize(vec_normalize: Any, size: int) -> Normalization | None:
    """Return the normalisation of `size` inputs by a `VecNormalize`; None if it normalises rewards only.

    A path is that of the file (.pkl) to which a `VecNormalize` was saved. Loading it executes code that is in it.
    """
    source = vec_normalize if isinstance(vec_normalize, str | Path) else "vec_normalize"
    try:
        found = vec_normalize if source == "vec_normalize" else pickle.loads(Path(source).read_bytes())
        if not found.norm_obs:
            return None
        mean, variance = found.obs_rms.mean, found.obs_rms.var
        clip = min(float(found.clip_obs), _LARGEST)
    except Exception as error:  # a damaged pickle can raise nearly any exception
        raise ValueError(f"{source} is not a VecNormalize of vectors, or its file: {brief(error)}") from error
    if mean.shape != (size,):
        raise ValueError(f"{source} must have statistics of {size} numbers, the inputs of the policy, not {mean.shape}")
    return Normalization(mean, np.sqrt(variance + found.epsilon), clip)


def statistics_files(model: Path) -> list[Path]:
    """Return the files that by their names have the statistics of a model (.zip), without copies.

    These are ``PREFIX_vecnormalize_N_steps.pkl`` beside ``PREFIX_N_steps.zip`` of a `CheckpointCallback`, else
    `STATISTICS` beside the model, in a folder with its name, and in ``ENV`` beside a model in the folder ``ENV_1`` of
    RL Baselines3 Zoo.
    """
    folder = model.parent
    if checkpoint := re.fullmatch(r"(.+)_(\d+)_steps", model.stem):
        own = folder / "{}_vecnormalize_{}_steps.pkl".format(*checkpoint.groups())
        if own.is_file():
            return [own]
    folders = [folder, folder / model.stem]
    if run := re.fullmatch(r"(.+)_\d+", folder.resolve().name):
        folders.append(folder / run[1])
    found = [path for folder in dict.fromkeys(folders) for name in STATISTICS if (path := folder / name).is_file()]
    # Stable-Baselines3 and the Zoo both save the statistics of one run, so files of the same content count as one.
    return [*{path.read_bytes(): path for path in reversed(found)}.values()]
