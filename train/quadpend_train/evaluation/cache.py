"""Cache of evaluation results: a repeated or interrupted evaluation computes only what is missing.

There is one file for each policy, scenario, number of episodes and seed. Its name is a hash of these, of the versions
of the libraries, and of the source files of the three packages as they are: any change of the code starts anew.
"""

import hashlib
import json
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import quadpend_baselines
import quadpend_gym
from quadpend_gym.scenarios import Scenario, scenario_data
from quadpend_train.common.files import atomic
from quadpend_train.common.provenance import versions
from quadpend_train.common.text import brief
from quadpend_train.evaluation.episodes import EpisodeResults

FOLDER = Path("results/cache")
_PACKAGES = (quadpend_gym.__file__, quadpend_baselines.__file__, Path(__file__).parents[1] / "__init__.py")
_SUFFIXES = (".py", ".toml", ".csv")  # policies have fingerprints of their own


@lru_cache(maxsize=1)
def code_hash() -> str:
    """Return the hash of the source files of the three packages and of the versions of the libraries."""
    digest = hashlib.sha256(json.dumps(versions()).encode())
    for folder in (Path(str(file)).parent for file in _PACKAGES):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in _SUFFIXES):
            digest.update(f"{path.relative_to(folder.parent).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def key(
    policies: Sequence[str], scenario: Scenario, episodes: int, seed: int, options: dict[str, Any] | None = None
) -> str:
    """Return the name of the cached file of an evaluation, without its suffix.

    Args:
        policies: Fingerprints of the policies.
        scenario: Scenario of the episodes.
        episodes: Number of episodes.
        seed: Seed of the first episode.
        options: Options of the environment's reset.
    """
    parts = [list(policies), scenario_data(scenario), episodes, seed, options, code_hash()]
    text = json.dumps(parts, sort_keys=True, default=lambda array: array.tolist())
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def load(folder: Path, name: str) -> EpisodeResults | None:
    """Return the cached results with this name; None if there are none, or, with a warning, if the file is damaged."""
    path = folder / f"{name}.npz"
    if not path.exists():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            return EpisodeResults(**{field: data[field] for field in EpisodeResults._fields})
    except Exception as error:  # readers of a damaged archive raise exceptions of many types
        warnings.warn(f"{path} is damaged and its results are computed again: {brief(error)}", stacklevel=2)
        return None


def save(folder: Path, name: str, results: EpisodeResults) -> None:
    """Save results under a name; an interruption leaves an existing file unchanged."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic(folder / f"{name}.npz") as unfinished, unfinished.open("wb") as file:
        np.savez(file, **results._asdict())
