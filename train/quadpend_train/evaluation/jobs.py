"""Run the evaluations of a study: load cached results, and run the missing evaluations with an executor."""

import hashlib
import json
from collections.abc import Hashable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple, TypeVar

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario, own_models
from quadpend_gym.wind import WindFromFactory
from quadpend_train.common.executors import Call, run
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes
from quadpend_train.policies.loading import cache_fingerprints, load_policies

Name = TypeVar("Name", bound=Hashable)


class Job(NamedTuple):
    """One evaluation of a policy in a scenario: the arguments of `run_episodes`.

    Attributes:
        policies: A name for `load_policies`, or a list of policies. Policies that are given as objects run in this
            process, and their results are cached only if they have a `fingerprint`.
        scenario: Scenario of the episodes.
        episodes: Number of episodes.
        seed: Seed of the first episode.
        options: Options of the environment's reset.
    """

    policies: str | Sequence[Policy]
    scenario: Scenario
    episodes: int
    seed: int
    options: dict[str, Any] | None = None

    def __call__(self) -> EpisodeResults:
        """Load the policies and run the episodes."""
        policies = load_policies(self.policies) if isinstance(self.policies, str) else self.policies
        return run_episodes(policies, self.scenario, self.episodes, self.seed, self.options)

    def cache_key(self) -> str | None:
        """Return the name under which the results are cached, see `cache.key`.

        None if they are not cached: a policy has no fingerprint, or the scenario has own models.
        """
        policies = cache_fingerprints(self.policies)
        if policies is None or own_models(self.scenario):
            return None
        if self.options is not None:
            options = json.dumps(self.options, sort_keys=True, default=lambda array: array.tolist())
            policies.append(hashlib.sha256(options.encode()).hexdigest())
        return cache.key(policies, self.scenario, self.episodes, self.seed)

    def runs_elsewhere(self) -> bool:
        """Return whether another process can run the job: it consists of names and data only."""
        own = own_models(self.scenario)
        return isinstance(self.policies, str) and all(isinstance(model, WindFromFactory) for model in own)


def run_jobs(
    jobs: Mapping[Name, Job],
    cache_folder: cache.Folder | None = None,
    recompute: bool = False,
    processes: int | Executor = 1,
) -> dict[Name, EpisodeResults]:
    """Run all jobs and return their results, which do not depend on `processes`.

    Args:
        jobs: Jobs by any hashable name.
        cache_folder: Folder of the cached results; only missing results are computed. None: no cache.
        recompute: Whether to ignore cached results and to run all jobs again.
        processes: Number of processes, or an executor.

    Raises:
        CallsFailedError: If jobs fail, for example since a policy is unknown or does not fit its scenario. The results
            of the others are cached.
        ValueError: If the file of a policy changes while the job runs, or the executor cannot run the jobs.
    """
    keys = {name: key for name, job in jobs.items() if cache_folder and (key := job.cache_key())}
    cached = {} if recompute else keys
    results = {
        name: found
        for name, key in cached.items()
        if cache_folder and (found := cache.load(cache_folder, key, jobs[name].scenario.steps)) is not None
    }
    missing = {name: job for name, job in jobs.items() if name not in results}

    def save(name: Name, result: EpisodeResults) -> None:
        if cache_folder and name in keys:
            if jobs[name].cache_key() != keys[name]:
                raise ValueError(
                    f"{jobs[name].policies} has changed during its evaluation: wait until its training is finished"
                )
            cache.save(cache_folder, keys[name], result)

    elsewhere: dict[Name, Call] = {name: job for name, job in missing.items() if job.runs_elsewhere()}
    here: dict[Name, Call] = {name: job for name, job in missing.items() if name not in elsewhere}
    kept = "are cached" if cache_folder else ""
    results |= run(elsewhere, processes, here=here, done=save, kept=kept, finished=len(results))
    return {name: results[name] for name in jobs}
