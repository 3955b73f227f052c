"""Comparison of policies: all of them run through the same episodes of every scenario.

Names of policies and scenarios become objects here; everything below carries the objects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.factories import split_name
from quadpend_gym.core.files import readable
from quadpend_gym.scenarios import Scenario, as_scenario, find_scenarios, scenario_data
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.linear_models import loop_margins, references
from quadpend_train.evaluation.metrics import Cell, cells, falls, rows, summarise
from quadpend_train.evaluation.ranking import RankingRow, gentle, ranking
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.policies.conversion import as_policy
from quadpend_train.policies.loading import check_policy, load_policies

Policies = Mapping[str, str | Policy | Sequence[Policy]] | Sequence[str | Policy]
Scenarios = Mapping[str, Any] | Sequence[str | Scenario]  # values as for `as_scenario`


@dataclass(frozen=True)
class Comparison:
    """Results of every policy in every scenario.

    `table` has one row for each episode, see `quadpend_train.evaluation.metrics`; its `attrs` have the provenance, the
    number of episodes in each scenario, and the seed of the first one.
    """

    table: pd.DataFrame
    errors: dict[Cell, Floats32]  # after each step, m, shape (s, n, T), see `EpisodeResults`
    scenarios: dict[str, Scenario]
    learners: dict[str, list[Policy]]  # one controller, or the training seeds of one learner
    margins: dict[Cell, Any] = field(default_factory=dict)  # of the linear loops, see `loop_margins`
    references: Mapping[str, float] = field(
        default_factory=dict
    )  # of scenarios with an unscored beginning, m, see `ranking`

    @property
    def policies(self) -> tuple[str, ...]:
        """Names of the policies."""
        return tuple(self.learners)

    @cached_property
    def summaries(self) -> dict[Cell, dict[str, Interval]]:
        """Metrics by the names of scenario and policy, see `summarise`."""
        return {cell: summarise(values) for cell, values in cells(self.table).items()}

    @cached_property
    def falls(self) -> dict[Cell, str]:
        """Numbers of falls with their causes by the names of scenario and policy."""
        return {cell: falls(values) for cell, values in cells(self.table).items()}

    @cached_property
    def ranking(self) -> list[RankingRow]:
        """The ranking of the policies by survival and error."""
        return ranking(self.table, self.references)


def compare(
    policies: Policies,
    scenarios: Scenarios,
    episodes: int = 100,
    seed: int = TEST_SEED,
    cache_folder: Path | str | None = None,
    jobs: int = 1,
) -> Comparison:
    """Run every policy through the same episodes of every scenario; the result does not depend on `jobs`.

    Args:
        policies: Mapping from names in the comparison to policies, or a sequence of policies, see `named_policies`. A
            policy is a name for `load_policies`, an object with the `predict` protocol, or a list of such objects (the
            training seeds of one learner). Results of objects are cached only if they have a `fingerprint`, see
            `quadpend_train.policies.conversion`.
        scenarios: Mapping from names in the comparison to scenarios, or a sequence of scenarios and sets, each a
            `Scenario` or a text, see `find_scenarios`. Results of scenarios with models of the user's own code are not
            cached.
        episodes: Number in each scenario.
        seed: Seed of the first episode.
        cache_folder: Folder of the cached results; only missing results are computed.
        jobs: Number of processes.
    """
    if not policies or not scenarios:
        raise ValueError("policies and scenarios must each have at least one entry")
    learners = {name: _learner(value) for name, value in named_policies(policies).items()}
    sizes = {name: len(seeds) for name, seeds in learners.items()}
    if len(set(sizes.values()) - {1}) > 1:  # differences are computed seed by seed
        numbers = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise ValueError(f"policies with several training seeds must have the same number of them: {numbers}")
    given = scenarios if isinstance(scenarios, Mapping) else find_scenarios(scenarios)
    found = {name: as_scenario(scenario) for name, scenario in given.items()}
    folder = None if cache_folder is None else Path(cache_folder)
    all_jobs = {(s, p): Job(learners[p], found[s], episodes, seed) for s in found for p in learners}
    for (scenario, name), job in all_jobs.items():  # a mismatch is found before the long evaluation
        if not ((path := job.file(folder)) and path.exists()):
            for policy in job.policies:
                check_policy(name, policy, scenario, job.scenario)
    margins = loop_margins(learners, found)
    results = run_jobs(all_jobs, folder, jobs)
    table = pd.concat([rows(*cell, result) for cell, result in results.items()], ignore_index=True)
    fingerprints = {name: [policy.fingerprint for policy in seeds] for name, seeds in learners.items()}
    table.attrs = {
        "provenance": provenance(),
        "policies": {name: None if None in texts else texts for name, texts in fingerprints.items()},
        "scenarios": {name: scenario_data(scenario) for name, scenario in found.items()},
        "episodes": episodes,
        "seed": seed,
    }
    errors = {cell: result.error for cell, result in results.items()}
    scored = {name: found[name] for name in gentle(list(found))}
    limits = references(scored) if all(scenario.unscored for scenario in scored.values()) else {}
    return Comparison(table, errors, found, learners, margins, limits)


def _learner(value: str | Policy | Sequence[Policy]) -> list[Policy]:
    """Return one controller or the training seeds of one learner, from a name for `load_policies` or from objects."""
    if isinstance(value, str):
        return load_policies(value)
    return [as_policy(item) for item in (value if isinstance(value, list | tuple) else [value])]


def named_policies(policies: Policies) -> Mapping[str, str | Policy | Sequence[Policy]]:
    """Return policies by name: that of a text NAME=POLICY, the text POLICY itself, or the class of an object."""
    if isinstance(policies, Mapping):
        return policies
    members = [policies] if isinstance(policies, str) else list(policies)
    texts = [split_name(item) if isinstance(item, str) else (type(item).__name__, item) for item in members]
    named = {readable(name or policy): policy for name, policy in texts}
    if len(named) < len(members):
        raise ValueError("two policies have the same name: give each its own, as NAME=POLICY or in a mapping")
    return named
