"""Run many evaluations: load cached results, and run the missing ones with an executor.

The cache has one file for each evaluation. Its name is a hash of the policies, scenario, episodes and seed, of the
versions of the libraries, and of the source files of the three packages as they are: any change of the code starts
anew.
"""

import hashlib
import json
from collections.abc import Hashable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

import quadpend_baselines
import quadpend_gym
from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario, own_models, scenario_data
from quadpend_train.common.executors import run
from quadpend_train.common.files import atomic
from quadpend_train.common.provenance import versions
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes

_PACKAGES = (quadpend_gym.__file__, quadpend_baselines.__file__, Path(__file__).parents[1] / "__init__.py")
_SUFFIXES = (".py", ".toml", ".csv")  # policies have fingerprints of their own

Name = TypeVar("Name", bound=Hashable)


class Job(NamedTuple):
    """One evaluation: arguments of `run_episodes`."""

    policies: list[Policy]
    scenario: Scenario
    episodes: int
    seed: int
    known: Scenario | None = None
    enough: float = np.inf

    def __call__(self) -> EpisodeResults:
        """Run the episodes."""
        return run_episodes(**self._asdict())

    def file(self, folder: Path | None) -> Path | None:
        """Return the file of the cached results; None without a folder, or if the job contains the user's own code."""
        fingerprints = [policy.fingerprint for policy in self.policies]
        if folder is None or None in fingerprints or own_models((self.scenario, self.known)):
            return None
        scenarios = [scenario_data(scenario) for scenario in (self.scenario, self.known) if scenario]
        parts = [fingerprints, scenarios, self.episodes, self.seed, self.enough, code_hash()]
        text = json.dumps(parts, sort_keys=True)
        return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"


@lru_cache(maxsize=1)
def code_hash() -> str:
    """Return the hash of the source files of the three packages and of the versions of the libraries."""
    digest = hashlib.sha256(json.dumps(versions()).encode())
    for folder in (Path(str(file)).parent for file in _PACKAGES):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in _SUFFIXES):
            digest.update(f"{path.relative_to(folder.parent).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def run_jobs(
    jobs: Mapping[Name, Job], cache_folder: Path | None = None, processes: int = 1
) -> dict[Name, EpisodeResults]:
    """Run all jobs and return their results, which do not depend on `processes`; only missing results are computed."""
    loaded = {name: _load(job.file(cache_folder)) for name, job in jobs.items()}
    results = {name: result for name, result in loaded.items() if result}
    missing = {name: partial(run_job, job, cache_folder) for name, job in jobs.items() if name not in results}
    results |= run(missing, processes, finished=len(results))
    return {name: results[name] for name in jobs}


def run_job(job: Job, cache_folder: Path | None = None) -> EpisodeResults:
    """Return the results of one job, in this process and without a progress bar."""
    if not (result := _load(path := job.file(cache_folder))):
        result = job()
        if path:
            with atomic(path) as unfinished, unfinished.open("wb") as file:
                np.savez(file, **result._asdict())
    return result


def _load(path: Path | None) -> EpisodeResults | None:
    """Return cached results; None if there are none, or if the file is damaged, as after a power failure."""
    if not path or not path.exists():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            return EpisodeResults(**data)
    except Exception:  # damaged archives raise errors of any type
        return None
