"""Cache of evaluation results: a repeated or interrupted study computes only the missing results.

There is one file for each policy, scenario, number of episodes and seed. Its name is a hash of these, of the package
versions and of the source code that determines the results. If one of them changes, the name changes, and the results
are computed again. Comments, docstrings and messages of exceptions are not part of the hash of the source code.

The folder of the files is local, or a URL such as ``s3://bucket/folder`` that fsspec opens.
"""

import hashlib
import io
import json
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import quadpend_baselines
import quadpend_gym
from quadpend_gym.core.source_hash import source_hash
from quadpend_gym.scenarios import Scenario, scenario_hash
from quadpend_train.common.files import atomic, writable_folder
from quadpend_train.common.provenance import versions
from quadpend_train.common.text import brief
from quadpend_train.evaluation.episodes import EpisodeResults

Folder = Path | str
FOLDER = "results/cache"
_TRAIN = Path(__file__).parents[1]  # the folder of quadpend_train
# Folders and files that do not influence the result of an episode.
_EXCLUDED = {
    quadpend_gym: ("viewer", "core/source_hash.py", "envs/recorder.py"),
    quadpend_baselines: ("paper", "planning"),
}


def sources() -> list[Path]:
    """Return the source files, and the planned flights, that determine the results of an episode."""
    found = [_TRAIN / "evaluation/episodes.py", *(_TRAIN / "policies").glob("*.py")]
    for package, names in _EXCLUDED.items():
        folder = Path(str(package.__file__)).parent
        excluded = [folder / name for name in names]
        files = [*folder.rglob("*.py"), *folder.rglob("*.csv"), *folder.rglob("*.toml")]
        found += [file for file in files if not any(file.is_relative_to(path) for path in excluded)]
    return sorted(found)


@lru_cache(maxsize=1)
def code_stamp() -> str:
    """Return the hash of `sources`, without comments and docstrings."""
    return source_hash(sources())


def key(policies: Sequence[str], scenario: Scenario, episodes: int, seed: int) -> str:
    """Return the name of the cached file of an evaluation, without its suffix.

    Args:
        policies: Fingerprints of the policies, see `quadpend_train.policies.loading.policy_fingerprint`.
        scenario: Scenario of the episodes.
        episodes: Number of episodes.
        seed: Seed of the first episode.
    """
    parts = [list(policies), scenario_hash(scenario), episodes, seed, versions(), code_stamp()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def check_folder(folder: Folder) -> None:
    """Create a folder of cached results, and check that files can be written in it.

    Raises:
        ValueError: If it is not a folder that can be written.
    """
    if (remote := _remote(folder, "check")) is None:
        writable_folder(Path(folder), "cache")
        return
    files, path = remote
    try:
        files.makedirs(path.rpartition("/")[0], exist_ok=True)
        files.pipe_file(path, b"0")
        files.rm_file(path)
    except Exception as error:  # file systems raise exceptions of many types
        raise ValueError(f"cache must be a folder that can be written, not {folder}: {brief(error)}") from error


def _remote(folder: Folder, name: str) -> tuple[Any, str] | None:
    """Return the file system of a folder that is a URL, and the path of a cached file there; None for a local folder.

    Raises:
        ValueError: If there is no such file system, or its package is not installed.
    """
    if "://" not in str(folder):
        return None
    import fsspec

    try:
        files, path = fsspec.core.url_to_fs(f"{str(folder).rstrip('/')}/{name}.npz")
    except (ImportError, ValueError) as error:
        raise ValueError(f"cache must be a folder or a URL that fsspec opens, not {folder}: {error}") from error
    return files, str(path)


def has(folder: Folder, name: str) -> bool:
    """Return whether there is a cached file with this name, damaged or not."""
    if remote := _remote(folder, name):
        return bool(remote[0].exists(remote[1]))
    return _path(folder, name).exists()


def load(folder: Folder, name: str, steps: int) -> EpisodeResults | None:
    """Return the cached results with this name; None if there are none, or, with a warning, if the file is damaged.

    Args:
        folder: Folder of the cached results.
        name: Name, see `key`.
        steps: Number of control steps of an episode.
    """
    if not has(folder, name):
        return None
    remote, path = _remote(folder, name), _path(folder, name)
    try:
        with (
            io.BytesIO(remote[0].cat_file(remote[1])) if remote else path.open("rb") as file,
            np.load(file, allow_pickle=False) as data,
        ):
            results = EpisodeResults(**{field: data[field] for field in EpisodeResults._fields})
        if results.error.shape != (*results.survived.shape, steps):
            raise ValueError("the shapes of its arrays do not match")
    except Exception as error:  # readers of a damaged archive raise exceptions of many types
        warnings.warn(f"{path} is damaged and its results are computed again: {brief(error)}", stacklevel=2)
        return None
    return results


def save(folder: Folder, name: str, results: EpisodeResults) -> None:
    """Save results under a name; an interruption or a full disk leaves an existing file unchanged, and nothing else."""
    if remote := _remote(folder, name):
        content = io.BytesIO()
        np.savez(content, **results._asdict())
        remote[0].makedirs(remote[1].rpartition("/")[0], exist_ok=True)
        remote[0].pipe_file(remote[1], content.getvalue())
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    with atomic(_path(folder, name)) as unfinished, unfinished.open("wb") as file:
        np.savez(file, **results._asdict())


def _path(folder: Folder, name: str) -> Path:
    return Path(folder) / f"{name}.npz"
