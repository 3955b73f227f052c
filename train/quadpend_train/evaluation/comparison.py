"""Comparison of policies in scenarios: metrics of every policy and paired differences, with confidence intervals."""

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.scenarios import (
    SCENARIOS,
    Scenario,
    as_scenario,
    check_own_models,
    expand_sets,
    scenario_data,
    scenario_hash,
)
from quadpend_train.common.files import atomic, to_json_data, write_text
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.episodes import VALIDATION_SEED, EpisodeResults
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval, interquartile_mean, mean, paired_proportion, proportion
from quadpend_train.policies.check import check_policy
from quadpend_train.policies.conversion import as_policy
from quadpend_train.policies.loading import load_policies, policy_fingerprints, policy_names

Cell = tuple[str, str]  # names of a scenario and of a policy
Policies = Mapping[str, str | Policy | Sequence[Policy]] | Sequence[str | Policy]
Scenarios = Mapping[str, Any] | Sequence[Any]  # values as for `as_scenario`


class Metric(NamedTuple):
    """A column of the comparison.

    Attributes:
        unit: Unit of the reported values; empty if there is none.
        better: 1 if larger values are better, -1 if smaller values are better.
        factor: Factor from SI units to `unit`.
    """

    unit: str
    better: int
    factor: float = 1.0


METRICS = {
    "survival": Metric("%", 1, 100.0),
    "penalised_rmse": Metric("mm", -1, 1000.0),
    "iqm": Metric("mm", -1, 1000.0),
    "rmse_of_survivors": Metric("mm", -1, 1000.0),
    "settled_rmse": Metric("mm", -1, 1000.0),
    "largest_tilt": Metric("°", -1, 180.0 / np.pi),
    "effort": Metric("", -1),
    "return": Metric("", 1),
}


def metric_values(results: EpisodeResults) -> dict[str, Any]:
    """Return the values of every metric for each episode, in SI units, shape (s, n) each; nan where undefined."""
    return {
        "survival": results.survived,
        "penalised_rmse": results.penalised_rmse,
        "iqm": results.penalised_rmse,
        "rmse_of_survivors": np.where(results.survived, results.rmse, np.nan),
        "settled_rmse": results.settled_rmse,
        "largest_tilt": results.largest_tilt,
        "effort": results.effort,
        "return": results.episode_return,
    }


def summarise(results: EpisodeResults) -> dict[str, Interval]:
    """Return every metric of `METRICS` in its unit, with its 95 % interval.

    ``rmse_of_survivors`` and ``settled_rmse`` are means over the survived episodes. ``penalised_rmse`` is the mean over
    all episodes, and ``iqm`` is its interquartile mean. No metric is negative.
    """
    estimators: dict[str, Callable[[Any], Interval]] = {"survival": proportion, "iqm": interquartile_mean}
    values = metric_values(results).items()
    return {
        name: estimators.get(name, mean)(value).not_negative().scaled(METRICS[name].factor) for name, value in values
    }


def differences(results: EpisodeResults, other: EpisodeResults) -> dict[str, Interval]:
    """Return the difference of every metric between two policies in the same episodes, with its paired 95 % interval.

    ``iqm`` is the interquartile mean of the differences. ``rmse_of_survivors`` and ``settled_rmse`` are means over the
    episodes that both survived.

    Args:
        results: Results of the policy.
        other: Results to subtract, of one policy or of as many training seeds as `results` has.
    """
    values, others = metric_values(results), metric_values(other)
    out = {"survival": paired_proportion(values.pop("survival"), others.pop("survival"))}
    for name, value in values.items():
        out[name] = (interquartile_mean if name == "iqm" else mean)(value - others[name])
    return {name: value.scaled(METRICS[name].factor) for name, value in out.items()}


@dataclass(frozen=True)
class Comparison:
    """Results of every policy in every scenario.

    Attributes:
        policies: Names of the policies.
        scenarios: Scenarios by name.
        episodes: Number of episodes in each scenario.
        seed: Seed of the first episode.
        results: Results by the names of scenario and policy.
        fingerprints: Fingerprints (see `policy_fingerprints`) of the policies that were given by name, not as objects.
    """

    policies: tuple[str, ...]
    scenarios: dict[str, Scenario]
    episodes: int
    seed: int
    results: dict[Cell, EpisodeResults]
    fingerprints: dict[str, list[str]]

    @cached_property
    def summaries(self) -> dict[Cell, dict[str, Interval]]:
        """Metrics by the names of scenario and policy, see `summarise`."""
        return {cell: summarise(results) for cell, results in self.results.items()}

    @cached_property
    def differences_from_first(self) -> dict[Cell, dict[str, Interval]]:
        """Differences from the first policy by the names of scenario and policy, see `differences`."""
        first = self.policies[0]
        return {
            (scenario, policy): differences(results, self.results[scenario, first])
            for (scenario, policy), results in self.results.items()
        }

    def as_data(self) -> dict[str, Any]:
        """Return provenance, metrics and differences from the first policy as data for JSON."""
        return {
            **self.provenance(),
            "units": {name: metric.unit for name, metric in METRICS.items()},
            "scenarios": {name: scenario_data(scenario) for name, scenario in self.scenarios.items()},
            "results": {
                scenario: {
                    policy: {
                        "metrics": to_json_data(self.summaries[scenario, policy]),
                        "differences_from_first": to_json_data(self.differences_from_first[scenario, policy]),
                    }
                    for policy in self.policies
                }
                for scenario in self.scenarios
            },
        }

    def provenance(self) -> dict[str, Any]:
        """Return the data that are needed to reproduce the numbers; every file of results contains them."""
        return {
            "provenance": provenance(),
            "code": cache.code_stamp()[:12],
            "policies": self.fingerprints,
            "scenario_hashes": {name: scenario_hash(scenario) for name, scenario in self.scenarios.items()},
            "episodes": self.episodes,
            "seed": self.seed,
        }

    def save(self, folder: Path) -> None:
        """Write `comparison.json` and `comparison.csv`, whose first line is the provenance, into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.as_data(), indent=1, allow_nan=False)
        write_text(folder / "comparison.json", text + "\n")
        path = folder / "comparison.csv"
        with atomic(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
            file.write(f"# {json.dumps(self.provenance())}\n")
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["scenario", "policy", "metric", "value", "low", "high", "unit"])
            for (scenario, policy), summary in self.summaries.items():
                for name, interval in summary.items():
                    table.writerow([scenario, policy, name, *interval, METRICS[name].unit])


def compare(
    policies: Policies,
    scenarios: Scenarios,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    cache_folder: cache.Folder | None = None,
    recompute: bool = False,
    jobs: int | Executor = 1,
) -> Comparison:
    """Run every policy through the same episodes of every scenario; the result does not depend on `jobs`.

    Args:
        policies: Mapping from names in the comparison to policies, or a sequence of policies. A policy is an object
            with the `predict` protocol, a list of such objects (the training seeds of one learner), or a name for
            `load_policies`. Policies that are given as objects run in this process, and their results are cached only
            if they have a `fingerprint`, see `quadpend_train.policies.own`.
        scenarios: Mapping from names in the comparison to scenarios, or a sequence of scenarios, each as for
            `as_scenario`: a `Scenario`, its name, or a wind model. Scenarios with models of the user's own code run in
            this process, and their results are not cached.
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
    compared = named_policies(policies)
    _check_training_seeds(compared)
    found = {name: _find_scenario(scenario) for name, scenario in _named_scenarios(scenarios).items()}
    cells = {(s, p): Job(compared[p], found[s], episodes, seed) for s in found for p in compared}
    _check_policies({cell: job for cell, job in cells.items() if recompute or not _is_cached(job, cache_folder)})
    known = {name: policy_fingerprints(policy) for name, policy in compared.items() if isinstance(policy, str)}
    return Comparison(tuple(compared), found, episodes, seed, run_jobs(cells, cache_folder, recompute, jobs), known)


def named_policies(policies: Policies) -> dict[str, str | Sequence[Policy]]:
    """Return policies by their names in a comparison, each as a name for `load_policies` or as a list of objects.

    Args:
        policies: As for `compare`. In a sequence, the name of an object is that of its class. Models of
            Stable-Baselines3 and torch modules are converted to policies.

    Raises:
        ValueError: If two policies have the same name.
    """
    if not isinstance(policies, Mapping):
        members = [policies] if isinstance(policies, str) else list(policies)
        names = [item if isinstance(item, str) else type(item).__name__ for item in members]
        if len(set(names)) < len(names):
            raise ValueError("two policies have the same name: give a mapping from names to policies")
        policies = dict(zip(names, members, strict=True))
    lists = {name: item if isinstance(item, str | list | tuple) else [item] for name, item in policies.items()}
    return {name: item if isinstance(item, str) else [as_policy(one) for one in item] for name, item in lists.items()}


def _find_scenario(value: Any) -> Scenario:
    """Return a scenario as `as_scenario`; an error about a file names the file."""
    try:
        return as_scenario(value)
    except (TypeError, ValueError) as error:
        if isinstance(value, str) and Path(value).is_file() and value not in str(error):
            raise type(error)(f"{value}: {error}") from error
        raise


def _named_scenarios(scenarios: Scenarios) -> Mapping[str, Any]:
    """Return scenarios by their names in a comparison; in a sequence, those without a name are numbered."""
    if isinstance(scenarios, Mapping):
        return scenarios
    given = [scenarios] if isinstance(scenarios, str) else scenarios
    members = [member for item in given for member in (expand_sets([item]) if isinstance(item, str) else (item,))]
    own = {name: scenario for name, scenario in SCENARIOS.items() if scenario in members}
    return {
        item if isinstance(item, str) else next((n for n, s in own.items() if s == item), f"scenario {i}"): item
        for i, item in enumerate(members, 1)
    }


def _is_cached(job: Job, cache_folder: cache.Folder | None) -> bool:
    key = job.cache_key() if cache_folder else None
    return cache_folder is not None and key is not None and cache.has(cache_folder, key)


def _check_training_seeds(policies: Mapping[str, str | Sequence[Policy]]) -> None:
    """Check that all learners have the same number of training seeds, since differences are computed seed by seed."""
    sizes = {
        name: len(policy_names(policy) if isinstance(policy, str) else policy) for name, policy in policies.items()
    }
    if len(set(sizes.values()) - {1}) > 1:
        numbers = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise ValueError(f"policies with several training seeds must have the same number of them: {numbers}")


def _check_policies(cells: Mapping[Cell, Job]) -> None:
    """Run every scenario and every policy for two steps, so that a mismatch is found before the long evaluation."""
    for scenario, found in {scenario: job.scenario for (scenario, _), job in cells.items()}.items():
        check_own_models(scenario, found)
    given = {name: job.policies for (_, name), job in cells.items()}
    loaded = {name: load_policies(policy) if isinstance(policy, str) else policy for name, policy in given.items()}
    for (scenario, name), job in cells.items():
        for policy in loaded[name]:
            check_policy(name, policy, scenario, job.scenario)
