"""The comparison of policies in scenarios: who flies how well, by how much better, and how sure that is."""

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy
from quadpend_gym.core.validation import check_int
from quadpend_train.common.files import plain
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.episodes import VALIDATION_SEED, EpisodeResults
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval, interquartile_mean, mean, paired_proportion, proportion
from quadpend_train.policies.adaptation import adapt_policy
from quadpend_train.policies.loading import load_policies, policy_fingerprints, policy_names
from quadpend_train.scenarios import Scenario, file_hash, find_scenario, scenario_hash

Cell = tuple[str, str]  # scenario and policy, by name


class Measure(NamedTuple):
    """A column of the comparison."""

    unit: str
    better: int  # the sign of a difference that means better
    factor: float = 1.0  # from SI units


MEASURES = {
    "survival": Measure("%", 1, 100.0),
    "penalised_rmse": Measure("mm", -1, 1000.0),
    "iqm": Measure("mm", -1, 1000.0),
    "rmse_of_survivors": Measure("mm", -1, 1000.0),
    "settled_rmse": Measure("mm", -1, 1000.0),
    "largest_tilt": Measure("°", -1, 180.0 / np.pi),
    "effort": Measure("", -1),
    "return": Measure("", 1),
}


def measured(flights: EpisodeResults) -> dict[str, Any]:
    """The values behind every measure, SI units, shape (s, n) each; nan where there is none."""
    return {
        "survival": flights.survived,
        "penalised_rmse": flights.penalised_rmse,
        "iqm": flights.penalised_rmse,
        "rmse_of_survivors": np.where(flights.survived, flights.rmse, np.nan),
        "settled_rmse": flights.settled_rmse,
        "largest_tilt": flights.largest_tilt,
        "effort": flights.effort,
        "return": flights.episode_return,
    }


def summarise(flights: EpisodeResults) -> dict[str, Interval]:
    """The measures of `MEASURES` in their units, each with its 95 % interval over the episodes.

    ``rmse_of_survivors`` and ``settled_rmse`` are of the episodes that were survived, ``penalised_rmse`` and ``iqm``,
    its interquartile mean, of all.
    """
    estimators: dict[str, Callable[[Any], Interval]] = {"survival": proportion, "iqm": interquartile_mean}
    values = measured(flights).items()
    return {name: estimators.get(name, mean)(value).scaled(MEASURES[name].factor) for name, value in values}


def differences(flights: EpisodeResults, other: EpisodeResults) -> dict[str, Interval]:
    """How far `flights` lies above `other`, with paired intervals: the same episodes, one minus the other.

    `other` is one policy, or has as many training seeds as `flights`; ``iqm`` is the interquartile mean of the
    differences, and ``rmse_of_survivors`` and ``settled_rmse`` are of the episodes that both survived.
    """
    mine, its = measured(flights), measured(other)
    out = {"survival": paired_proportion(mine.pop("survival"), its.pop("survival"))}
    for name, value in mine.items():
        out[name] = (interquartile_mean if name == "iqm" else mean)(value - its[name])
    return {name: value.scaled(MEASURES[name].factor) for name, value in out.items()}


@dataclass(frozen=True)
class Comparison:
    """Every policy in every scenario.

    Attributes:
        policies: their names.
        scenarios: by their names.
        episodes: flown in each cell.
        seed: of the first episode.
        flights: by scenario and policy.
        identities: of the policies that were given by name: gains, or hashes of model files.
    """

    policies: tuple[str, ...]
    scenarios: dict[str, Scenario]
    episodes: int
    seed: int
    flights: dict[Cell, EpisodeResults]
    identities: dict[str, list[str]]

    @cached_property
    def summaries(self) -> dict[Cell, dict[str, Interval]]:
        """Every cell's measures, see `summarise`."""
        return {cell: summarise(flights) for cell, flights in self.flights.items()}

    @cached_property
    def minus_first(self) -> dict[Cell, dict[str, Interval]]:
        """Every cell's differences from the first policy, see `differences`."""
        first = self.policies[0]
        return {
            (name, policy): differences(flown, self.flights[name, first])
            for (name, policy), flown in self.flights.items()
        }

    def as_data(self) -> dict[str, Any]:
        """Numbers and intervals for JSON; differences are against the first policy."""
        return {
            **self.provenance(),
            "units": {name: measure.unit for name, measure in MEASURES.items()},
            "scenarios": {name: asdict(scenario) for name, scenario in self.scenarios.items()},
            "results": {
                scenario: {
                    policy: {
                        "measures": plain(self.summaries[scenario, policy]),
                        "minus_first": plain(self.minus_first[scenario, policy]),
                    }
                    for policy in self.policies
                }
                for scenario in self.scenarios
            },
        }

    def provenance(self) -> dict[str, Any]:
        """What it takes to make the same numbers again, which stands in every file of results."""
        return {
            "origin": provenance(),
            "code": cache.code_stamp()[:12],
            "policies": self.identities,
            "scenario_file": file_hash(),
            "scenario_hashes": {name: scenario_hash(scenario) for name, scenario in self.scenarios.items()},
            "episodes": self.episodes,
            "seed": self.seed,
        }

    def save(self, folder: Path) -> None:
        """Write `comparison.json` and `comparison.csv` into `folder`; the latter's first line says how it was made."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.as_data(), indent=1, allow_nan=False)
        (folder / "comparison.json").write_text(text + "\n", encoding="utf-8")
        with (folder / "comparison.csv").open("w", encoding="utf-8", newline="") as file:
            file.write(f"# {json.dumps(self.provenance())}\n")
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["scenario", "policy", "measure", "value", "low", "high", "unit"])
            for (scenario, policy), summary in self.summaries.items():
                for name, interval in summary.items():
                    table.writerow([scenario, policy, name, *interval, MEASURES[name].unit])


def compare(
    policies: Mapping[str, str | Policy | list[Policy] | tuple[Policy, ...]],
    scenarios: Sequence[str] | Mapping[str, str],
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    folder: Path | None = None,
    fresh: bool = False,
    jobs: int = 1,
) -> Comparison:
    """Fly every policy through the same episodes of every scenario; the result is the same whatever `jobs` is.

    Args:
        policies: by the names they shall have: what `load_policies` takes, or policies themselves, which are flown in
            this process and not kept; under one name, a controller or the training seeds of one learner.
        scenarios: what `find_scenario` takes for scenarios; by the names they shall have, or under that.
        episodes: in each scenario.
        seed: of the first.
        folder: where flights are kept, so that only those missing are flown; None: nowhere.
        fresh: whether to fly all of them again.
        jobs: processes that fly.

    Raises:
        ValueError: there is no policy or no scenario, one is unknown, a policy cannot fly in a scenario, two learners
            have different numbers of training seeds, or a number is out of range.
    """
    if not policies or not scenarios:
        raise ValueError("there must be at least one policy and one scenario to compare")
    for value, name, least in ((episodes, "episodes", 1), (seed, "seed", 0), (jobs, "jobs", 1)):
        check_int(value, name, least)
    contenders: dict[str, str | Sequence[Policy]] = {
        name: given if isinstance(given, str | list | tuple) else [given] for name, given in policies.items()
    }
    _check_seeds(contenders)
    named = scenarios if isinstance(scenarios, Mapping) else {name: name for name in scenarios}
    found = {name: find_scenario(scenario) for name, scenario in named.items()}
    cells = {(s, p): Job(contenders[p], found[s], episodes, seed) for s in found for p in policies}
    _check_flights({cell: job for cell, job in cells.items() if fresh or not _kept(job, folder)})
    known = {name: policy_fingerprints(given) for name, given in contenders.items() if isinstance(given, str)}
    return Comparison(tuple(policies), found, episodes, seed, run_jobs(cells, folder, fresh, jobs), known)


def _kept(job: Job, folder: Path | None) -> bool:
    key = job.key() if folder else None
    return folder is not None and key is not None and cache.has(folder, key)


def _check_seeds(policies: Mapping[str, str | Sequence[Policy]]) -> None:
    """Differences are taken seed by seed, or from one policy."""
    sizes = {
        name: len(policy_names(policy) if isinstance(policy, str) else policy) for name, policy in policies.items()
    }
    if len(set(sizes.values()) - {1}) > 1:
        told = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise ValueError(f"learners must have the same number of training seeds to be compared: {told}")


def _check_flights(cells: Mapping[Cell, Job]) -> None:
    """Try policies on one observation of their scenarios, before hours are flown in vain."""
    wanted = {name: job.policies for (_, name), job in cells.items()}
    loaded = {name: load_policies(named) if isinstance(named, str) else named for name, named in wanted.items()}
    for (scenario, name), job in cells.items():
        env = job.scenario.make_vec(1, AutoresetMode.SAME_STEP)
        try:
            for policy in loaded[name]:
                observation, _ = env.reset(seed=0)
                action, _ = adapt_policy(policy, job.scenario).predict(observation, None, np.ones(1, np.bool_))
                env.step(action)
        except ValueError as error:
            raise ValueError(f"{name} cannot fly in {scenario}: {error}") from error
