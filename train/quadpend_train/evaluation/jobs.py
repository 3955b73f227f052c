"""Run many evaluations: load cached results, and run the missing ones with an executor."""

from collections.abc import Hashable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario, own_models
from quadpend_train.common.executors import run
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes
from quadpend_train.policies.conversion import as_policy
from quadpend_train.policies.loading import cache_fingerprints, load_policies

Name = TypeVar("Name", bound=Hashable)


class Learner(NamedTuple):
    """The training seeds of one learner, or one controller.

    Attributes:
        policies: One policy for each training seed.
        fingerprints: A text for each policy that determines what it does; None if one of them has none.
    """

    policies: list[Policy]
    fingerprints: list[str] | None


def load_learner(value: str | Policy | Sequence[Policy]) -> Learner:
    """Load policies by name, see `load_policies`, or take policies, models of Stable-Baselines3 or torch modules."""
    if isinstance(value, str):
        policies = load_policies(value)
    else:
        policies = [as_policy(item) for item in (value if isinstance(value, list | tuple) else [value])]
    return Learner(policies, cache_fingerprints(policies))


class Job(NamedTuple):
    """One evaluation: the arguments of `run_episodes`.

    Attributes:
        learner: Policies to run.
        scenario: Scenario of the episodes.
        episodes: Number of episodes.
        seed: Seed of the first episode.
        options: Options of the environment's reset.
    """

    learner: Learner
    scenario: Scenario
    episodes: int
    seed: int
    options: dict[str, Any] | None = None

    def __call__(self) -> EpisodeResults:
        """Run the episodes."""
        return run_episodes(self.learner.policies, *self[1:])

    def key(self) -> str | None:
        """Return the name under which the results are cached.

        None if they are not cached: a policy has no fingerprint, or the scenario has models of the user's own code.
        """
        if self.learner.fingerprints is None or own_models(self.scenario):
            return None
        return cache.key(self.learner.fingerprints, *self[1:])

    def is_cached(self, folder: Path | None) -> bool:
        """Return whether a folder has cached results of this job, damaged or not."""
        return folder is not None and (key := self.key()) is not None and (folder / f"{key}.npz").exists()


def run_jobs(
    jobs: Mapping[Name, Job], cache_folder: Path | None = None, recompute: bool = False, processes: int | Executor = 1
) -> dict[Name, EpisodeResults]:
    """Run all jobs and return their results, which do not depend on `processes`.

    Args:
        jobs: Jobs by any hashable name.
        cache_folder: Folder of the cached results; only missing results are computed. None: no cache.
        recompute: Whether to ignore cached results and to run all jobs again.
        processes: Number of processes, or an executor.

    Raises:
        CallsFailedError: If jobs fail, when all others have ended and are cached.
    """
    keys = {name: job.key() if cache_folder else None for name, job in jobs.items()}
    results = {}
    for name, key in keys.items():
        if cache_folder and key and not recompute and (found := cache.load(cache_folder, key)) is not None:
            results[name] = found
    missing = {name: job for name, job in jobs.items() if name not in results}

    def save(name: Name, result: EpisodeResults) -> None:
        if cache_folder and (key := keys[name]):
            cache.save(cache_folder, key, result)

    kept = "are cached" if cache_folder else ""
    results |= run(missing, processes, done=save, kept=kept, finished=len(results))
    return {name: results[name] for name in jobs}
