"""Flights on disk, so that an interrupted comparison goes on where it was and a repeated one flies nothing.

One file for each policy, scenario, number of episodes and seed. Its name is a hash of these, of the packages' versions
and of the source that flies: whatever changes one of them asks for another file.
"""

import hashlib
import json
import os
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from quadpend_train.common.provenance import versions
from quadpend_train.evaluation.episodes import STEPS, EpisodeResults
from quadpend_train.scenarios import Scenario, scenario_hash

FOLDER = Path("results/store")
_ROOT = Path(__file__).parents[4]
_SOURCES = [
    "quadpend_gym",
    "baselines",
    "train/quadpend_train/evaluation/episodes.py",
    "train/quadpend_train/policies/mlp_policy.py",
    "train/quadpend_train/policies/loading.py",
    "train/quadpend_train/scenarios/scenario.py",
    "train/quadpend_train/policies/finite_differences.py",
]


@lru_cache(maxsize=1)
def code_stamp() -> str:
    """Hash of every source file that has a say in a flight."""
    digest = hashlib.sha256()
    for source in _SOURCES:
        path = _ROOT / source
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            if file.parent.name == "viewer":  # pictures change no flight
                continue
            digest.update(f"{file.relative_to(_ROOT).as_posix()}\0".encode() + file.read_bytes())
    return digest.hexdigest()


def key(policies: Sequence[str], scenario: Scenario, episodes: int, seed: int) -> str:
    """What the file of these flights is called.

    Args:
        policies: what tells each from all others, see `quadpend_train.policies.loading.policy_fingerprint`.
        scenario: flown.
        episodes: how many.
        seed: of the first.
    """
    cell = [list(policies), scenario_hash(scenario), episodes, seed, versions(), code_stamp()]
    return hashlib.sha256(json.dumps(cell).encode()).hexdigest()[:32]


def has(folder: Path, name: str) -> bool:
    """Whether flights are kept under `name`, damaged or not."""
    return _path(folder, name).exists()


def load(folder: Path, name: str) -> EpisodeResults | None:
    """The flights kept under `name`, or None; a damaged file is as good as none, with a warning."""
    if not has(folder, name):
        return None
    path = _path(folder, name)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            flights = EpisodeResults(**{field: data[field] for field in EpisodeResults._fields})
        if flights.error.shape != (*flights.survived.shape, STEPS):
            raise ValueError("its arrays do not fit together")
    except Exception as error:  # whatever a broken archive makes its readers raise
        warnings.warn(f"{path} is damaged and will be flown again: {error}", stacklevel=2)
        return None
    return flights


def save(folder: Path, name: str, flights: EpisodeResults) -> None:
    """Keep flights under `name`; an interruption leaves what was there."""
    folder.mkdir(parents=True, exist_ok=True)
    unfinished = folder / f"{name}.{os.getpid()}.tmp"
    with unfinished.open("wb") as file:
        np.savez(file, **flights._asdict())
    unfinished.replace(_path(folder, name))


def _path(folder: Path, name: str) -> Path:
    return folder / f"{name}.npz"
