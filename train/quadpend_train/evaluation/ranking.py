"""The ranking of policies: survival first, and then the error as a multiple of a reference.

Survival counts in groups of scenarios: each set ``events-…`` of the package is one, and all other scenarios are another
one, the gentle one, whose errors count:

    (1)  exp( mean over gentle scenarios s of  ½ log(mean of e² over survived episodes) − log r_s )

with the RMSE e of the scored steps of an episode and the reference r_s. The interval of (1) is that of its
linearisation in the means of e². r_s divides the errors of all policies alike, so it sets the scale of (1) and no order
depends on it. Where a scenario has none, it is the smallest error in the table: then (1) compares only within a table.

- A policy has a rank only if in every group the lower 95 % bound of its survival is at least `LEAST`: Clopper and
  Pearson's (`least_proportion`).
- A may stand above B only if in every group the upper 95 % bound of the paired loss of survival of A against B is below
  `LOSS`: Tango's (`largest_loss`). If each may stand above the other, the lower error (1) decides. That is an order of
  estimates, which is not tested.

The flights of a group are pooled. Its scenarios have episodes with the same seeds, so the bounds divide the number of
flights by the design effect of clusters that are the episodes. All bounds are one-sided. A rule for every group is an
intersection–union test, so its level is 5 % without a correction; the levels of several policies and pairs are not
corrected. All training seeds of a learner are pooled and count as one, and their bounds are at least as wide as those
of the population of training seeds.

These pairs need not be an order: none of two may stand above the other, or A stands above B, B above C and C above A.
So places go to the smallest sets of policies whose members all stand above all later ones. Members of one set share
their rank, and are listed by survival. Policies without a rank follow by survival. With fewer than `EPISODES` episodes
in a group no loss is below `LOSS`, so no policy has a rank.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.scenarios import SETS
from quadpend_train.evaluation.metrics import Values, cells
from quadpend_train.evaluation.statistics import Interval, largest_loss, least_proportion, mean, proportion

LEAST, LOSS = 0.98, 0.01  # of survival
EPISODES = 268  # fewest in a group: without a fall, the bound of the loss is below `LOSS`
GENTLE = "gentle"


class RankingRow(NamedTuple):
    """One policy in the ranking."""

    policy: str
    rank: int  # equal for policies that share it
    has_rank: bool
    survival: Interval  # %, of all episodes
    least: float  # %, smallest of the bounds of survival of the groups
    group: str  # whose bound it is
    falls: int  # of all training seeds
    multiple: Interval  # (1); nan if the policy falls in all episodes of a scenario
    effort: float  # mean over all episodes


def groups(scenarios: Sequence[str]) -> dict[str, list[str]]:
    """Return the names of scenarios by group; a scenario with another vehicle is in that of its name without it."""
    events = {member: name for name, members in SETS.items() if name.startswith("events-") for member in members}
    found: dict[str, list[str]] = {}
    for scenario in scenarios:
        found.setdefault(events.get(scenario.partition(" · ")[0], GENTLE), []).append(scenario)
    return found


def gentle(scenarios: Sequence[str]) -> list[str]:
    """Return the names of the scenarios whose errors count: the gentle ones, or all if there are none."""
    return groups(scenarios).get(GENTLE, list(scenarios))


def too_few(table: pd.DataFrame) -> str:
    """Return the sentence that a table of results has too few episodes to rank; empty if it has enough."""
    scenarios, episodes = list(dict.fromkeys(table["scenario"])), table["episode"].nunique()
    name, members = min(groups(scenarios).items(), key=lambda item: len(item[1]))
    if episodes * len(members) >= EPISODES:
        return ""
    return f"Not enough episodes to rank: the group {name} has {episodes * len(members)}, and needs {EPISODES}."


def ranking(table: pd.DataFrame, references: Mapping[str, float] | None = None) -> list[RankingRow]:
    """Return the rows of all policies, the best first.

    `references` are those of the scenarios, m; that of a scenario without one is the smallest error of the policies
    that survive often enough for a rank, or of all if none does.
    """
    results: dict[str, dict[str, Values]] = {}
    for (scenario, policy), values in cells(table).items():
        results.setdefault(policy, {})[scenario] = values
    names, members = list(results), groups(list(dict.fromkeys(table["scenario"])))
    survived = {
        name: {group: np.stack([found[scenario]["survived"] for scenario in own], 1) for group, own in members.items()}
        for name, found in results.items()
    }
    least = {name: {group: least_proportion(each) for group, each in of.items()} for name, of in survived.items()}
    safe = [] if too_few(table) else [name for name in names if min(least[name].values()) >= LEAST]
    scored = gentle(list(dict.fromkeys(table["scenario"])))
    errors = {name: [survivors(results[name][scenario]) for scenario in scored] for name in names}
    smallest = np.fmin.reduce([[_size(error) for error in errors[name]] for name in safe or names])
    limits = [(references or {}).get(name, size) for name, size in zip(scored, smallest, strict=True)]
    multiples = {name: multiple(errors[name], limits) for name in names}
    pooled = {name: np.concatenate([*of.values()], 1) for name, of in survived.items()}

    def may_stand_above(first: str, second: str) -> bool:
        return all(largest_loss(*_seeds(survived[first][group], survived[second][group])) < LOSS for group in members)

    def stands_above(first: str, second: str) -> bool:
        lower = multiples[first].value < multiples[second].value
        return may_stand_above(first, second) and (lower or not may_stand_above(second, first))

    def by_survival(name: str) -> tuple[float, float]:
        return -float(pooled[name].mean()), float(np.nan_to_num(multiples[name].value, nan=np.inf))

    ranked = [name for name in safe if not np.isnan(multiples[name].value)]
    sets = [*ordered_sets(sorted(ranked, key=by_survival), stands_above)]
    sets += [[name] for name in sorted(names, key=by_survival) if name not in ranked]
    rows: list[RankingRow] = []
    for together in sets:
        rank = len(rows) + 1
        for name in together:
            bound, group = min((bound, group) for group, bound in least[name].items())
            rows.append(
                RankingRow(
                    name,
                    rank,
                    name in ranked,
                    proportion(pooled[name]).scaled(100.0),
                    100.0 * bound,
                    group,
                    int(np.sum(~pooled[name])),
                    multiples[name],
                    float(np.mean([values["effort"].mean() for values in results[name].values()])),
                )
            )
    return rows


def ordered_sets(names: Sequence[str], above: Callable[[str, str], bool]) -> list[list[str]]:
    """Return the smallest sets of names whose members all stand above all of the later sets, in the order of `names`.

    Every member of such a set stands above more others than any later one does, so the sets are parts of the names
    sorted by that number.
    """
    wins = {name: {other for other in names if other != name and above(name, other)} for name in names}
    order, sets, begin = sorted(names, key=lambda name: -len(wins[name])), [], 0
    for end in range(1, len(order) + 1):
        if all(wins[name].issuperset(order[end:]) for name in order[begin:end]):
            sets.append([name for name in names if name in order[begin:end]])
            begin = end
    return sets


def _seeds(first: Booleans, second: Booleans) -> tuple[Booleans, Booleans]:
    """Return survivals whose first axes agree: a controller has one training seed."""
    shape = np.broadcast_shapes(first.shape, second.shape)
    return np.broadcast_to(first, shape), np.broadcast_to(second, shape)


def survivors(values: Values) -> Floats:
    """Return the RMSE of each episode, m, nan for falls."""
    return np.asarray(np.where(values["survived"], values["rmse"], np.nan))


def _size(error: Floats) -> float:
    """Return the root mean square, nan if nothing is left."""
    return float(np.sqrt(np.nanmean(error**2))) if not np.isnan(error).all() else np.nan


def multiple(errors: Sequence[Floats], references: Sequence[float]) -> Interval:
    """Return (1) for the RMSE of each scenario, m, shape (s, n), nan for falls, and the references, m."""
    squares = [error**2 / _size(error) ** 2 for error in errors]  # of mean 1
    value = float(np.exp(np.mean(np.log([_size(error) for error in errors]) - np.log(references))))
    influence = [np.where(np.isnan(x), 0.0, 0.5 * (x - 1.0) / (1.0 - np.isnan(x).mean())) for x in squares]
    if np.isnan(value):
        return Interval(np.nan, np.nan, np.nan)
    _, low, high = mean(np.mean(influence, axis=0))
    return Interval(value, value * float(np.exp(low)), value * float(np.exp(high)))
