"""Flying many cells of a study: those kept on disk are not flown again, the others in several processes."""

import hashlib
import json
from collections.abc import Generator, Hashable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing
from multiprocessing import get_context
from pathlib import Path
from signal import SIG_IGN, SIGINT, signal
from typing import Any, NamedTuple, TypeVar

from tqdm.auto import tqdm

from quadpend_baselines import Policy
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.episodes import EpisodeResults, run_episodes
from quadpend_train.policies.loading import load_policies, policy_fingerprints
from quadpend_train.scenarios import Scenario

Name = TypeVar("Name", bound=Hashable)


class Job(NamedTuple):
    """One cell, as the arguments of `quadpend_train.evaluation.episodes.fly`."""

    policies: str | Sequence[Policy]  # what `load_policies` takes, or policies, which stay in this process, unkept
    scenario: Scenario
    episodes: int
    seed: int
    options: dict[str, Any] | None = None

    def fly(self) -> EpisodeResults:
        """Do it."""
        policies = load_policies(self.policies) if isinstance(self.policies, str) else self.policies
        return run_episodes(policies, self.scenario, self.episodes, self.seed, self.options)

    def key(self) -> str | None:
        """What the flights are kept under, see `store.key`; None: they are not."""
        if not isinstance(self.policies, str):
            return None
        known = policy_fingerprints(self.policies)
        if self.options is not None:
            told = json.dumps(self.options, sort_keys=True, default=lambda array: array.tolist())
            known.append(hashlib.sha256(told.encode()).hexdigest())
        return cache.key(known, self.scenario, self.episodes, self.seed)


def run_jobs(
    jobs: Mapping[Name, Job], folder: Path | None = None, fresh: bool = False, processes: int = 1
) -> dict[Name, EpisodeResults]:
    """Fly all jobs; the flights are the same whatever `processes` is.

    Args:
        jobs: by whatever name.
        folder: where flights are kept, so that only those missing are flown; None: nowhere.
        fresh: whether to fly all of them again.
        processes: that fly.

    Raises:
        ValueError: there is no such policy, it cannot fly in a scenario, or its file changes meanwhile.
    """
    keys = {name: key for name, job in jobs.items() if folder and (key := job.key())}
    kept = {} if fresh or not folder else {name: cache.load(folder, key) for name, key in keys.items()}
    flights = {name: flown for name, flown in kept.items() if flown is not None}
    missing = {name: job for name, job in jobs.items() if name not in flights}
    with (
        tqdm(total=len(jobs), initial=len(flights), unit="cell", leave=False) as bar,
        closing(_arriving(missing, processes)) as arriving,
    ):
        for name, flown in arriving:
            if folder and name in keys:
                if jobs[name].key() != keys[name]:
                    raise ValueError(f"{jobs[name].policies} has changed while it was flown: wait until it is trained")
                cache.save(folder, keys[name], flown)
            flights[name] = flown
            bar.update()
    return {name: flights[name] for name in jobs}


def _arriving(jobs: Mapping[Name, Job], processes: int) -> Generator[tuple[Name, EpisodeResults], None, None]:
    """Flights in whatever order they are ready: with several processes, of policies that have names in others."""
    away = {name: job for name, job in jobs.items() if processes > 1 and isinstance(job.policies, str)}
    if away:
        pool = ProcessPoolExecutor(min(processes, len(away)), get_context("spawn"), signal, (SIGINT, SIG_IGN))
        try:
            flying = {pool.submit(job.fly): name for name, job in away.items()}
            for future in as_completed(flying):
                yield flying[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)
    for name, job in jobs.items():
        if name not in away:
            yield name, job.fly()
