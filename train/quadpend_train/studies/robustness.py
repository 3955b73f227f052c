"""Robustness: how survival and tracking error grow worse along axes of trouble, and how far a policy can be pushed.

Every policy meets the same episodes at every value of an axis: starts, references, headings and the noise's random
numbers are common, only the size of the trouble differs. The edge of an axis is the value, interpolated linearly
between those flown, at which the estimated survival first falls below `ENDURED`; its interval is where the ends of
survival's interval do.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.core.validation import check_int
from quadpend_train.common.files import plain
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation.episodes import VALIDATION_SEED, EpisodeResults
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.statistics import Interval, mean, proportion
from quadpend_train.studies.attraction import CALM_HOVER, MAPS, Map, RecoveryMap, RecoveryOutcome, classify
from quadpend_train.studies.axes import AXES, Axis

TOLERATED_SURVIVAL = 0.9  # share of episodes survived, down to which an axis counts as endured


class Point(NamedTuple):
    """A policy at one value of an axis."""

    value: float  # in the axis's unit
    survival: Interval  # share of the episodes
    rmse: Interval  # of the survivors, m; nan where there is none
    penalised_rmse: Interval  # of all, a fall counting as 1 m


class Edge(NamedTuple):
    """How far an axis is endured in one direction.

    Attributes:
        value: where survival falls below `ENDURED`, or the last value flown; nan: already at the nominal value.
        reached: whether it does fall.
    """

    value: float
    reached: bool


def edge(values: Sequence[float], survival: Sequence[float]) -> Edge:
    """Where survival first falls below `ENDURED`.

    Args:
        values: from the nominal one outwards.
        survival: share of the episodes at each.
    """
    below = [share < TOLERATED_SURVIVAL for share in survival]
    if below[0]:
        return Edge(np.nan, True)
    if not any(below):
        return Edge(values[-1], False)
    i = below.index(True)
    step = (survival[i - 1] - TOLERATED_SURVIVAL) / (survival[i - 1] - survival[i])
    return Edge(values[i - 1] + step * (values[i] - values[i - 1]), True)


def edges(axis: Axis, points: Sequence[Point], bound: int = 0) -> tuple[Edge, ...]:
    """The edges of an axis: upwards, and before it downwards if the nominal value is not the first.

    Args:
        axis: the axis.
        points: a policy on it.
        bound: 0 for the estimate, 1 and 2 for the ends of its interval.
    """
    values, survival = [point.value for point in points], [point.survival[bound] for point in points]
    middle = values.index(axis.nominal)
    upwards = edge(values[middle:], survival[middle:])
    return (edge(values[middle::-1], survival[middle::-1]), upwards) if middle else (upwards,)


def tolerated_range(axis: Axis, points: Sequence[Point]) -> str:
    """The edges of an axis and their intervals as text, in its unit.

    ``0.4 [0.3, 0.5]``; ``> 0.6`` where the end of the axis is endured; – where its nominal value is not. With trouble
    on both sides, the edge downwards comes first.
    """
    sides = list(zip(*(edges(axis, points, bound) for bound in range(3)), strict=True))
    signs = ("<", ">")[-len(sides) :]
    return " to ".join(_told_side(side, sign) for sign, side in zip(signs, sides, strict=True))


def _told_side(side: Sequence[Edge], sign: str) -> str:
    estimate, near, far = (_told(edge, sign) for edge in side)
    low, high = (near, far) if sign == ">" else (far, near)
    return f"{estimate} [{low}, {high}]" if side[1].reached else estimate


def _told(edge: Edge, sign: str) -> str:
    if np.isnan(edge.value):
        return "–"
    return f"{edge.value:.2g}" if edge.reached else f"{sign} {edge.value:g}"


@dataclass(frozen=True)
class Robustness:
    """Every policy on every axis and map.

    Attributes:
        policies: their names.
        axes: by name.
        maps: by name.
        episodes: at each value of an axis.
        seed: of the first episode.
        curves: a point for each value, by axis and policy.
        basins: by map and policy.
    """

    policies: tuple[str, ...]
    axes: Mapping[str, Axis]
    maps: Mapping[str, Map]
    episodes: int
    seed: int
    curves: dict[tuple[str, str], list[Point]]
    basins: dict[tuple[str, str], RecoveryMap]

    def as_data(self) -> dict[str, Any]:
        """Numbers and intervals for JSON: survival in shares, errors in m."""
        return {
            "origin": provenance(),
            "episodes": self.episodes,
            "seed": self.seed,
            "endured": TOLERATED_SURVIVAL,
            "axes": {name: self._axis(name, axis) for name, axis in self.axes.items()},
            "maps": {name: self._map(name, item) for name, item in self.maps.items()},
        }

    def save(self, folder: Path) -> None:
        """Write `robustness.json` into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.as_data(), allow_nan=False)
        (folder / "robustness.json").write_text(text + "\n", encoding="utf-8")

    def _axis(self, name: str, axis: Axis) -> dict[str, Any]:
        curves = {policy: self.curves[name, policy] for policy in self.policies}
        return {
            "title": axis.title,
            "unit": axis.unit,
            "nominal": axis.nominal,
            "curves": {
                policy: [{key: plain(part) for key, part in point._asdict().items()} for point in points]
                for policy, points in curves.items()
            },
            "edges": {
                policy: [plain(part) for part in zip(*(edges(axis, points, i) for i in range(3)), strict=True)]
                for policy, points in curves.items()
            },
        }

    def _map(self, name: str, item: Map) -> dict[str, Any]:
        return {
            "title": item.title,
            "x": {"title": item.x.title, "unit": item.x.unit, "values": item.x.values.round(9).tolist()},
            "y": {"title": item.y.title, "unit": item.y.unit, "values": item.y.values.round(9).tolist()},
            "outcomes": {outcome.name.lower(): int(outcome) for outcome in RecoveryOutcome},
            "basins": {
                policy: {
                    "recovered": self.basins[name, policy].recovered,
                    "outcome": self.basins[name, policy].outcome.tolist(),
                    "time": plain(self.basins[name, policy].time.round(2).tolist()),
                }
                for policy in self.policies
            },
        }


def measure_robustness(
    policies: Mapping[str, str | Sequence[Policy]],
    axes: Mapping[str, Axis] = AXES,
    maps: Mapping[str, Map] = MAPS,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    folder: Path | None = None,
    fresh: bool = False,
    jobs: int = 1,
) -> Robustness:
    """Fly every policy along every axis and from every start of every map.

    Args:
        policies: by the names they shall have: what `load_policies` takes, or policies themselves, as in
            `quadpend_train.evaluation.comparison.compare`.
        axes: by name.
        maps: by name.
        episodes: at each value of an axis.
        seed: of the first.
        folder: where flights are kept, so that only those missing are flown; None: nowhere.
        fresh: whether to fly all of them again.
        jobs: processes that fly.

    Raises:
        ValueError: there is no policy, one is unknown, or a number is out of range.
    """
    if not policies:
        raise ValueError("there must be at least one policy to measure")
    for value, name, least in ((episodes, "episodes", 1), (seed, "seed", 0), (jobs, "jobs", 1)):
        check_int(value, name, least)
    points = {
        (name, policy, value): Job(flown, axis.scenario(value), episodes, seed, axis.options(value, episodes, seed))
        for name, axis in axes.items()
        for policy, flown in policies.items()
        for value in axis.values
    }
    grids = {
        (name, policy): Job(flown, CALM_HOVER, item.x.values.size * item.y.values.size, seed, item.options())
        for name, item in maps.items()
        for policy, flown in policies.items()
    }
    cells: dict[tuple[Any, ...], Job] = {**points, **grids}
    flights = run_jobs(cells, folder, fresh, jobs)
    return Robustness(
        tuple(policies),
        axes,
        maps,
        episodes,
        seed,
        {
            (name, policy): [_point(value, flights[name, policy, value]) for value in axis.values]
            for name, axis in axes.items()
            for policy in policies
        },
        {(name, policy): classify(flights[name, policy], maps[name]) for name, policy in grids},
    )


def _point(value: float, flights: EpisodeResults) -> Point:
    return Point(
        value,
        proportion(flights.survived),
        mean(np.where(flights.survived, flights.rmse, np.nan)),
        mean(flights.penalised_rmse),
    )


def markdown(robustness: Robustness) -> str:
    """What each policy endures on each axis, and the share of each map from which it recovers, as a table."""
    lines = [["", *robustness.policies], ["---"] * (1 + len(robustness.policies))]
    for name, axis in robustness.axes.items():
        lines.append(
            [axis.label, *(tolerated_range(axis, robustness.curves[name, policy]) for policy in robustness.policies)]
        )
    for name, item in robustness.maps.items():
        shares = (robustness.basins[name, policy].recovered for policy in robustness.policies)
        lines.append([f"{item.title.lower()}: recovered (%)", *(f"{100.0 * share:.0f}" for share in shares)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
