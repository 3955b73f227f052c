"""Robustness: survival and tracking error under perturbations of increasing size, and the tolerated range.

At every value of a perturbation axis, every policy runs through the same episodes: starts, references, headings and the
random numbers of the noise are common, only the size of the perturbation differs. The tolerance limit of an axis is the
value at which the estimated survival first falls below `TOLERATED_SURVIVAL`, interpolated linearly between the values
of the axis. The ends of its interval are computed in the same way from the two ends of the interval of the survival.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks import TASKS
from quadpend_train.common.files import to_json_data, write_text
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation.cache import Folder
from quadpend_train.evaluation.episodes import VALIDATION_SEED, EpisodeResults
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval, mean, proportion
from quadpend_train.studies.perturbations import PERTURBATION_AXES, PerturbationAxis
from quadpend_train.studies.recovery import (
    CALM,
    START_GRIDS,
    RecoveryMap,
    RecoveryOutcome,
    StartGrid,
    classify_recovery,
)

TOLERATED_SURVIVAL = 0.9  # share of episodes


class CurvePoint(NamedTuple):
    """Metrics of a policy at one value of a perturbation axis.

    Attributes:
        value: Value of the perturbation, in the unit of the axis.
        survival: Share of survived episodes.
        rmse: Mean RMSE of the survived episodes, m; nan if there are none.
        penalised_rmse: Mean penalised RMSE of all episodes, m.
    """

    value: float
    survival: Interval
    rmse: Interval
    penalised_rmse: Interval


class ToleranceLimit(NamedTuple):
    """The largest tolerated perturbation in one direction.

    Attributes:
        value: Value at which survival falls below `TOLERATED_SURVIVAL`, or the last evaluated value if it does not; nan
            if survival is below `TOLERATED_SURVIVAL` at the nominal value.
        reached: Whether survival falls below `TOLERATED_SURVIVAL`.
    """

    value: float
    reached: bool


def tolerance_limit(values: Sequence[float], survival: Sequence[float]) -> ToleranceLimit:
    """Return the value at which survival first falls below `TOLERATED_SURVIVAL`.

    Args:
        values: Values from the nominal one outwards.
        survival: Share of survived episodes at each value.
    """
    below = [share < TOLERATED_SURVIVAL for share in survival]
    if below[0]:
        return ToleranceLimit(np.nan, True)
    if not any(below):
        return ToleranceLimit(values[-1], False)
    i = below.index(True)
    fraction = (survival[i - 1] - TOLERATED_SURVIVAL) / (survival[i - 1] - survival[i])
    return ToleranceLimit(values[i - 1] + fraction * (values[i] - values[i - 1]), True)


def tolerance_limits(
    axis: PerturbationAxis, points: Sequence[CurvePoint], bound: int = 0
) -> tuple[ToleranceLimit, ...]:
    """Return the upper tolerance limit; or the lower and the upper one if the nominal value is not the first value.

    Args:
        axis: Perturbation axis.
        points: Metrics of a policy at the axis' values.
        bound: 0 for the estimated survival, 1 and 2 for the ends of its interval.
    """
    values, survival = [point.value for point in points], [point.survival[bound] for point in points]
    nominal = values.index(axis.nominal)
    upper = tolerance_limit(values[nominal:], survival[nominal:])
    return (tolerance_limit(values[nominal::-1], survival[nominal::-1]), upper) if nominal else (upper,)


def format_tolerated_range(axis: PerturbationAxis, points: Sequence[CurvePoint]) -> str:
    """Return the tolerance limits of an axis and their intervals as text, in the unit of the axis.

    Examples: ``0.4 [0.3, 0.5]``; ``> 0.6`` if all values are tolerated; ``–`` if the nominal value is not. If the
    nominal value is not the first one, the lower limit stands first: ``0.8 [0.7, 0.9] to > 2``.
    """
    limits = list(zip(*(tolerance_limits(axis, points, bound) for bound in range(3)), strict=True))
    signs = ("<", ">")[-len(limits) :]
    return " to ".join(_format_with_interval(limit, sign) for sign, limit in zip(signs, limits, strict=True))


def _format_with_interval(limits: Sequence[ToleranceLimit], sign: str) -> str:
    """Return an estimated limit with the limits of the lower and the upper end of the survival's interval."""
    estimate, at_low, at_high = (_format_limit(limit, sign) for limit in limits)
    low, high = (at_low, at_high) if sign == ">" else (at_high, at_low)
    return f"{estimate} [{low}, {high}]" if limits[1].reached else estimate


def _format_limit(limit: ToleranceLimit, sign: str) -> str:
    if np.isnan(limit.value):
        return "–"
    return f"{limit.value:.2g}" if limit.reached else f"{sign} {limit.value:g}"


@dataclass(frozen=True)
class Robustness:
    """Robustness of several policies.

    Attributes:
        policies: Names of the policies.
        axes: Perturbation axes by name.
        start_grids: Grids of starts by name.
        episodes: Number of episodes at each value of an axis.
        seed: Seed of the first episode.
        curves: Metrics at each value of an axis, by the names of axis and policy.
        recovery_maps: Recovery maps by the names of grid and policy.
    """

    policies: tuple[str, ...]
    axes: Mapping[str, PerturbationAxis]
    start_grids: Mapping[str, StartGrid]
    episodes: int
    seed: int
    curves: dict[tuple[str, str], list[CurvePoint]]
    recovery_maps: dict[tuple[str, str], RecoveryMap]

    def as_data(self) -> dict[str, Any]:
        """Return all numbers as data for JSON: survival as shares, errors in m."""
        return {
            "provenance": provenance(),
            "episodes": self.episodes,
            "seed": self.seed,
            "tolerated_survival": TOLERATED_SURVIVAL,
            "axes": {name: self._axis_data(name, axis) for name, axis in self.axes.items()},
            "recovery": {name: self._recovery_data(name, grid) for name, grid in self.start_grids.items()},
        }

    def save(self, folder: Path) -> None:
        """Write `robustness.json` into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.as_data(), allow_nan=False)
        write_text(folder / "robustness.json", text + "\n")

    def _axis_data(self, name: str, axis: PerturbationAxis) -> dict[str, Any]:
        curves = {policy: self.curves[name, policy] for policy in self.policies}
        limits = {
            policy: zip(*(tolerance_limits(axis, points, bound) for bound in range(3)), strict=True)
            for policy, points in curves.items()
        }
        return {
            "title": axis.title,
            "unit": axis.unit,
            "nominal": axis.nominal,
            "curves": {policy: to_json_data(points) for policy, points in curves.items()},
            "tolerance_limits": {policy: to_json_data(list(found)) for policy, found in limits.items()},
        }

    def _recovery_data(self, name: str, grid: StartGrid) -> dict[str, Any]:
        maps = {policy: self.recovery_maps[name, policy] for policy in self.policies}
        return {
            "title": grid.title,
            "x": {"title": grid.x.title, "unit": grid.x.unit, "values": grid.x.values.round(9).tolist()},
            "y": {"title": grid.y.title, "unit": grid.y.unit, "values": grid.y.values.round(9).tolist()},
            "outcomes": {outcome.name.lower(): int(outcome) for outcome in RecoveryOutcome},
            "maps": {
                policy: {
                    "recovered": found.recovered,
                    "outcome": found.outcome.tolist(),
                    "time": to_json_data(found.time.round(2).tolist()),
                }
                for policy, found in maps.items()
            },
        }


def measure_robustness(
    policies: Mapping[str, str | Sequence[Policy]],
    axes: Mapping[str, PerturbationAxis] = PERTURBATION_AXES,
    start_grids: Mapping[str, StartGrid] = START_GRIDS,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    cache_folder: Folder | None = None,
    recompute: bool = False,
    jobs: int | Executor = 1,
    base: Scenario = CALM,
) -> Robustness:
    """Evaluate every policy at all values of every perturbation axis and from all starts of every grid.

    Args:
        policies: Policies by name: names for `load_policies`, or sequences of policies, as in
            `quadpend_train.evaluation.comparison.compare`.
        axes: Perturbation axes by name.
        start_grids: Grids of starts by name.
        episodes: Number of episodes at each value of an axis.
        seed: Seed of the first episode.
        cache_folder: Folder of the cached results; only missing results are computed. None: no cache.
        recompute: Whether to ignore cached results.
        jobs: Number of processes, or an executor.
        base: Scenario whose nominal simulation (vehicle and control period) and duration are used; its other fields
            have no effect.

    Raises:
        ValueError: If there is no policy, one is unknown, or a number is out of range.
    """
    if not policies:
        raise ValueError("policies must have at least one entry")
    base = replace(
        Scenario(),
        vehicle=base.vehicle,
        interface=base.interface,
        period=base.period,
        substeps=base.substeps,
        duration=base.duration,
    )
    on_axes = {
        (name, policy, value): Job(
            members, axis.scenario(value, base), episodes, seed, axis.options(value, episodes, seed)
        )
        for name, axis in axes.items()
        for policy, members in policies.items()
        for value in axis.values
    }
    hover = replace(base, task=TASKS["hover"])
    on_grids = {
        (name, policy): Job(members, hover, grid.x.values.size * grid.y.values.size, seed, grid.options())
        for name, grid in start_grids.items()
        for policy, members in policies.items()
    }
    all_jobs: dict[tuple[Any, ...], Job] = {**on_axes, **on_grids}
    results = run_jobs(all_jobs, cache_folder, recompute, jobs)
    return Robustness(
        tuple(policies),
        axes,
        start_grids,
        episodes,
        seed,
        {
            (name, policy): [_curve_point(value, results[name, policy, value]) for value in axis.values]
            for name, axis in axes.items()
            for policy in policies
        },
        {
            (name, policy): classify_recovery(results[name, policy], start_grids[name], base.simulation.period)
            for name, policy in on_grids
        },
    )


def _curve_point(value: float, results: EpisodeResults) -> CurvePoint:
    return CurvePoint(
        value,
        proportion(results.survived),
        mean(np.where(results.survived, results.rmse, np.nan)).not_negative(),
        mean(results.penalised_rmse).not_negative(),
    )


def markdown(robustness: Robustness) -> str:
    """Return a Markdown table: the tolerated range on each axis and the share of recovered starts on each grid."""
    rows = []
    for name, axis in robustness.axes.items():
        ranges = (format_tolerated_range(axis, robustness.curves[name, policy]) for policy in robustness.policies)
        rows.append([axis.label, *ranges])
    for name, grid in robustness.start_grids.items():
        shares = (robustness.recovery_maps[name, policy].recovered for policy in robustness.policies)
        rows.append([f"{grid.title.lower()}: recovered (%)", *(f"{100.0 * share:.0f}" for share in shares)])
    return markdown_table(["", *robustness.policies], rows) + "\n"
