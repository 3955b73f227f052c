"""Comparison of policies: all of them run through the same episodes of every scenario.

Names of policies and scenarios become objects here; everything below carries the objects.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario, as_scenario, check_own_models, find_scenarios, scenario_data
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.jobs import Job, Learner, load_learner, run_jobs
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.evaluation.table import Cell, cells, rows, summarise
from quadpend_train.policies.check import check_policy

Policies = Mapping[str, str | Policy | Sequence[Policy]] | Sequence[str | Policy]
Scenarios = Mapping[str, Any] | Sequence[str | Scenario]  # values as for `as_scenario`


@dataclass(frozen=True)
class Comparison:
    """Results of every policy in every scenario.

    Attributes:
        table: One row for each episode, see `quadpend_train.evaluation.table`; `attrs` has the provenance.
        errors: Error after each step by the names of scenario and policy, m, shape (s, n, T), see `EpisodeResults`.
        scenarios: Scenarios by name.
        learners: Policies by name.
    """

    table: pd.DataFrame
    errors: dict[Cell, Floats32]
    scenarios: dict[str, Scenario]
    learners: dict[str, Learner]

    @property
    def policies(self) -> tuple[str, ...]:
        """Names of the policies."""
        return tuple(self.learners)

    @property
    def episodes(self) -> int:
        """Number of episodes in each scenario."""
        return int(self.table.attrs["episodes"])

    @property
    def seed(self) -> int:
        """Seed of the first episode."""
        return int(self.table.attrs["seed"])

    @cached_property
    def summaries(self) -> dict[Cell, dict[str, Interval]]:
        """Metrics by the names of scenario and policy, see `summarise`."""
        return {cell: summarise(values) for cell, values in cells(self.table).items()}


def compare(
    policies: Policies,
    scenarios: Scenarios,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    cache_folder: Path | str | None = None,
    recompute: bool = False,
    jobs: int | Executor = 1,
) -> Comparison:
    """Run every policy through the same episodes of every scenario; the result does not depend on `jobs`.

    Args:
        policies: Mapping from names in the comparison to policies, or a sequence of policies. A policy is a name for
            `load_policies`, an object with the `predict` protocol, or a list of such objects (the training seeds of one
            learner). In a sequence, the name of an object is that of its class. Results of objects are cached only if
            they have a `fingerprint`, see `quadpend_train.policies.own`.
        scenarios: Mapping from names in the comparison to scenarios, or a sequence of scenarios and sets, each a
            `Scenario` or a text, see `find_scenarios`. Results of scenarios with models of the user's own code are not
            cached.
        episodes: Number of episodes in each scenario.
        seed: Seed of the first episode.
        cache_folder: Folder of the cached results; only missing results are computed. None: no cache.
        recompute: Whether to ignore cached results.
        jobs: Number of processes, or an executor of `quadpend_train.common.executors`.

    Raises:
        TypeError: If a policy or a scenario has the wrong type.
        ValueError: If there is no policy or no scenario, two have the same name, one is unknown, a policy fails or does
            not fit a scenario, two learners have different numbers of training seeds, or a number is out of range.
    """
    if not policies or not scenarios:
        raise ValueError("policies and scenarios must each have at least one entry")
    learners = {name: load_learner(value) for name, value in _named_policies(policies).items()}
    given = scenarios if isinstance(scenarios, Mapping) else find_scenarios(scenarios)
    found = {name: as_scenario(scenario) for name, scenario in given.items()}
    _check_training_seeds(learners)
    folder = None if cache_folder is None else Path(cache_folder)
    all_jobs = {(s, p): Job(learners[p], found[s], episodes, seed) for s in found for p in learners}
    _check_flights({cell: job for cell, job in all_jobs.items() if recompute or not job.is_cached(folder)})
    results = run_jobs(all_jobs, folder, recompute, jobs)
    table = pd.concat([rows(*cell, result) for cell, result in results.items()], ignore_index=True)
    table.attrs = {
        "provenance": provenance(),
        "policies": {name: learner.fingerprints for name, learner in learners.items()},
        "scenarios": {name: scenario_data(scenario) for name, scenario in found.items()},
        "episodes": episodes,
        "seed": seed,
    }
    return Comparison(table, {cell: result.error for cell, result in results.items()}, found, learners)


def _named_policies(policies: Policies) -> Mapping[str, str | Policy | Sequence[Policy]]:
    if isinstance(policies, Mapping):
        return policies
    members = [policies] if isinstance(policies, str) else list(policies)
    names = [item if isinstance(item, str) else type(item).__name__ for item in members]
    if len(set(names)) < len(names):
        raise ValueError("two policies have the same name: give a mapping from names to policies")
    return dict(zip(names, members, strict=True))


def _check_training_seeds(learners: Mapping[str, Learner]) -> None:
    """Check that all learners have the same number of training seeds, since differences are computed seed by seed."""
    sizes = {name: len(learner.policies) for name, learner in learners.items()}
    if len(set(sizes.values()) - {1}) > 1:
        numbers = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise ValueError(f"policies with several training seeds must have the same number of them: {numbers}")


def _check_flights(jobs: Mapping[Cell, Job]) -> None:
    """Fly every policy for two steps in its scenarios, so that a mismatch is found before the long evaluation."""
    for scenario, found in {scenario: job.scenario for (scenario, _), job in jobs.items()}.items():
        check_own_models(scenario, found)
    for (scenario, name), job in jobs.items():
        for policy in job.learner.policies:
            check_policy(name, policy, scenario, job.scenario)
