"""Stored results of `quadpend bound`: the best flight that was found for each episode by a planner that knows it all.

It is a local optimum: the best flight that exists may be better.

`bound.csv` has one line for each episode. It is no policy: it is planned with start, reference, wind and parameters
known in advance.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_train.common.files import atomic
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.episodes import FALL_ERROR
from quadpend_train.evaluation.leaderboard import LeaderboardRow
from quadpend_train.evaluation.statistics import Interval, mean, proportion

CLAIRVOYANT = "clairvoyant"  # its name in tables


@dataclass(frozen=True)
class BoundEpisode:
    """The best flight that was found for an episode; its numbers are those of a flight through the environment.

    Attributes:
        scenario: Name of the scenario.
        seed: Seed of the episode.
        survived: Whether the flight survived.
        rmse: Root mean square of the tracking error, mm; nan for a fall.
        settled_rmse: The same of the second half of the episode, mm; nan for a fall.
        planned_rmse: RMSE that the planner predicted for its last flight, mm.
        source: "optimum", or the name of the policy whose flight was better; empty for a fall.
        status: Return status of the solver.
        iterations: Iterations of the solver.
        seconds: Processor time of planning and flights, s.
        key: Hash of everything that determines the flight; a line with another key is computed again.
    """

    scenario: str
    seed: int
    survived: bool
    rmse: float
    settled_rmse: float
    planned_rmse: float
    source: str
    status: str
    iterations: int
    seconds: float
    key: str

    @property
    def penalised_rmse(self) -> float:
        """RMSE in mm, at most 1 m; 1 m for a fall."""
        fall = 1000.0 * FALL_ERROR
        return min(self.rmse, fall) if self.survived else fall


_COLUMNS = {item.name: item.type for item in fields(BoundEpisode)}


def write_bound(path: Path, episodes: Sequence[BoundEpisode]) -> None:
    """Write a `bound.csv`; an interruption leaves an existing file unchanged."""
    with atomic(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, _COLUMNS, lineterminator="\n")
        table.writeheader()
        for episode in episodes:
            table.writerow({**asdict(episode), "survived": int(episode.survived)})


def read_bound(path: Path) -> list[BoundEpisode]:
    """Return the episodes of a `bound.csv`.

    Raises:
        ValueError: If there is no such file, or it is not the table of `quadpend bound`.
    """
    if not path.is_file():
        raise ValueError(f"bound must be a file bound.csv of `quadpend bound`, not {path}: there is no such file")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [_parsed(row) for row in csv.DictReader(file)]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"bound must be a file bound.csv of `quadpend bound`; {path} is not: {error!r}") from error


def _parsed(row: Mapping[str, str]) -> BoundEpisode:
    read: dict[Any, Any] = {bool: lambda text: bool(int(text)), int: int, float: float, str: str}
    return BoundEpisode(**{name: read[kind](row[name]) for name, kind in _COLUMNS.items()})


def by_scenario(
    episodes: Sequence[BoundEpisode], scenarios: Sequence[str], seed: int, most: int
) -> dict[str, list[BoundEpisode]]:
    """Return the stored episodes of some scenarios, all with the same consecutive seeds.

    Args:
        episodes: Stored episodes.
        scenarios: Names of the scenarios.
        seed: Seed of the first episode.
        most: Largest number of episodes of a scenario.

    Raises:
        ValueError: If the first episode of a scenario is not stored.
    """
    found = {(item.scenario, item.seed): item for item in episodes}
    count = 0
    while count < most and all((name, seed + count) in found for name in scenarios):
        count += 1
    if not count:
        missing = next(name for name in scenarios if (name, seed) not in found)
        raise ValueError(f"bound has no episode of the scenario {missing!r} with the seed {seed}")
    return {name: [found[name, seed + k] for k in range(count)] for name in scenarios}


def penalised_rmse(episodes: Sequence[BoundEpisode]) -> Floats:
    """Return the penalised RMSE of each episode, mm, shape (1, n)."""
    return np.array([[item.penalised_rmse for item in episodes]])


def settled_rmse(episodes: Sequence[BoundEpisode]) -> Floats:
    """Return the settled RMSE of each episode, mm, shape (1, n); nan for a fall."""
    return np.array([[item.settled_rmse for item in episodes]])


def bound_row(found: Mapping[str, Sequence[BoundEpisode]], comparison: Comparison, reference: str) -> LeaderboardRow:
    """Return the row of the leaderboard for the episodes of `by_scenario`; wins and losses are not counted.

    The planned episodes are the first ones of a comparison with more episodes. Their starts may be nearer to the
    target, or farther, so their mean would not be comparable with the other rows. A reference policy corrects for that
    (control variate): c_k is the median over the scenarios of its error in episode k, which depends on the start and
    hardly on falls, and the row is the mean of the planned flights, plus the mean of c over all episodes, minus its
    mean over the planned ones.

    Survival is that of the flights that were found: a lower bound, since there may be others.

    Args:
        found: Planned episodes of each scenario.
        comparison: Comparison over the same and further episodes.
        reference: Name of the reference policy.
    """
    episodes = len(next(iter(found.values())))
    errors = [1000.0 * comparison.results[name, reference].penalised_rmse.mean(axis=0) for name in found]
    control = np.median(errors, axis=0)
    planned = np.mean([penalised_rmse(flights) for flights in found.values()], axis=0)
    above = mean(planned - control[:episodes])
    level = float(control.mean())
    survived = {name: np.array([[item.survived for item in flights]]) for name, flights in found.items()}
    worst = min(survived, key=lambda name: float(survived[name].mean()))
    pooled = proportion(np.concatenate(list(survived.values()), axis=1))
    survival = mean(np.mean(list(survived.values()), axis=0)).clipped(0.0, 1.0).widened(pooled)
    return LeaderboardRow(
        f"{CLAIRVOYANT} (no policy; from {episodes} episodes)",
        Interval(*(level + value for value in above)),
        survival.scaled(100.0),
        proportion(survived[worst]).scaled(100.0),
        worst,
        None,
        None,
    )
