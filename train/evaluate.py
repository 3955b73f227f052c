"""Flying policies through the same episodes and measuring how well they do.

Episode k of a scenario (start, reference, wind) depends on the seed and on k only, so every policy meets the same
episodes and differences can be taken episode by episode.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from tqdm.auto import tqdm

from baselines import Policy
from quadpend_gym.arrays import Booleans, Floats
from train.scenarios import find_scenario
from train.statistics import Interval, mean, proportion

TEST_SEED = 1_000_000  # episodes that no training run has seen: rows of training count up from its seed
SETTLED = 500  # control steps after which the start should no longer matter


class Flights(NamedTuple):
    """n episodes of one policy.

    Attributes:
        survived: whether the episode lasted its 1000 steps, shape (n,).
        rmse: root mean square of the tracking error's norm over the steps flown, m, shape (n,).
        settled_rmse: the same from step 500 on, m; nan where the episode ended before, shape (n,).
        largest_tilt: of the pendulum from upright, rad, shape (n,).
        effort: root mean square of the action's norm, shape (n,).
        episode_return: sum of rewards, shape (n,).
        error: norm of the tracking error at each step, nan after the end, m, shape (n, 1000).
    """

    survived: Booleans
    rmse: Floats
    settled_rmse: Floats
    largest_tilt: Floats
    effort: Floats
    episode_return: Floats
    error: Floats


def fly(policy: Policy, scenario: str, episodes: int = 100, seed: int = TEST_SEED) -> Flights:
    """Fly `policy` through the first episode of each of `episodes` seeds, counting up from `seed`.

    Args:
        policy: anything that obeys the `predict` protocol.
        scenario: a name in `train.scenarios.SCENARIOS`.
        episodes: how many.
        seed: of the first.

    Raises:
        ValueError: there is no such scenario.
    """
    env = find_scenario(scenario).make_vec(episodes, AutoresetMode.SAME_STEP)
    observation, _ = env.reset(seed=seed)
    memory: Any = None
    started = np.ones(episodes, np.bool_)
    flying = np.ones(episodes, np.bool_)
    survived = np.zeros(episodes, np.bool_)
    columns: list[Floats] = []
    while flying.any():
        action, memory = policy.predict(observation, memory, started, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        last = info.get("final_info", info)
        error = np.linalg.norm(last["tracking_error"], axis=1)
        column = np.stack([error, last["tilt"], np.linalg.norm(action, axis=1), reward])
        columns.append(np.where(flying, column, np.nan))
        survived |= flying & truncated & ~terminated
        started = terminated | truncated
        flying &= ~started
    error, tilt, effort, rewards = np.stack(columns, axis=-1)
    return Flights(
        survived,
        np.sqrt(np.nanmean(error**2, axis=1)),
        _settled(error),
        np.nanmax(tilt, axis=1),
        np.sqrt(np.nanmean(effort**2, axis=1)),
        np.nansum(rewards, axis=1),
        error,
    )


def _settled(error: Floats) -> Floats:
    late = error[:, SETTLED:]
    count = np.sum(~np.isnan(late), axis=1)
    total = np.nansum(late**2, axis=1)
    mean_square: Floats = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    return np.sqrt(mean_square)


# column of the table: unit and, for how much a policy is better than another, the sign that means better
MEASURES = {
    "survival": ("%", 1),
    "rmse": ("mm", -1),
    "settled_rmse": ("mm", -1),
    "largest_tilt": ("°", -1),
    "effort": ("", -1),
    "return": ("", 1),
}
_FACTOR = {"%": 100.0, "mm": 1000.0, "°": 180.0 / np.pi, "": 1.0}


def summarise(flights: Flights) -> dict[str, Interval]:
    """The measures of `MEASURES` in their units, each with its 95 % interval over the episodes."""
    values = {
        "survival": proportion(flights.survived),
        "rmse": mean(flights.rmse),
        "settled_rmse": mean(flights.settled_rmse[~np.isnan(flights.settled_rmse)]),
        "largest_tilt": mean(flights.largest_tilt),
        "effort": mean(flights.effort),
        "return": mean(flights.episode_return),
    }
    return {name: Interval(*(_FACTOR[MEASURES[name][0]] * x for x in value)) for name, value in values.items()}


def differences(flights: Flights, other: Flights) -> dict[str, Interval]:
    """How far `flights` lies above `other`, with paired intervals: the same episodes, one minus the other."""
    both = ~np.isnan(flights.settled_rmse) & ~np.isnan(other.settled_rmse)
    pairs = {
        "survival": flights.survived.astype(np.float64) - other.survived,
        "rmse": flights.rmse - other.rmse,
        "settled_rmse": (flights.settled_rmse - other.settled_rmse)[both],
        "largest_tilt": flights.largest_tilt - other.largest_tilt,
        "effort": flights.effort - other.effort,
        "return": flights.episode_return - other.episode_return,
    }
    return {name: mean(_FACTOR[MEASURES[name][0]] * pair) for name, pair in pairs.items()}


@dataclass(frozen=True)
class Comparison:
    """Every policy in every scenario.

    Attributes:
        policies: their names.
        scenarios: their names.
        episodes: flown in each cell.
        seed: of the first episode.
        flights: by scenario and policy.
    """

    policies: tuple[str, ...]
    scenarios: tuple[str, ...]
    episodes: int
    seed: int
    flights: dict[tuple[str, str], Flights]

    def as_data(self) -> dict[str, Any]:
        """Numbers and intervals for JSON; differences are against the first policy."""
        results: dict[str, Any] = {}
        for scenario in self.scenarios:
            first = self.flights[scenario, self.policies[0]]
            results[scenario] = {
                policy: {
                    "measures": {k: v._asdict() for k, v in summarise(self.flights[scenario, policy]).items()},
                    "minus_first": {
                        k: v._asdict() for k, v in differences(self.flights[scenario, policy], first).items()
                    },
                }
                for policy in self.policies
            }
        return {
            "episodes": self.episodes,
            "seed": self.seed,
            "units": {name: unit for name, (unit, _) in MEASURES.items()},
            "scenarios": {name: asdict(find_scenario(name)) for name in self.scenarios},
            "results": results,
        }

    def save(self, folder: Path) -> None:
        """Write `comparison.json` into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.as_data(), indent=1)
        (folder / "comparison.json").write_text(text + "\n", encoding="utf-8")


def compare(
    policies: dict[str, Policy], scenarios: Sequence[str], episodes: int = 100, seed: int = TEST_SEED
) -> Comparison:
    """Fly every policy through the same episodes of every scenario.

    Args:
        policies: by the names they shall have.
        scenarios: names in `train.scenarios.SCENARIOS`.
        episodes: in each scenario.
        seed: of the first.

    Raises:
        ValueError: there is no policy or no scenario, one is unknown, or `episodes` is below 1.
    """
    if not policies or not scenarios:
        raise ValueError("there must be at least one policy and one scenario to compare")
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, not {episodes}")
    for name in scenarios:
        find_scenario(name)
    cells = [(scenario, policy) for scenario in scenarios for policy in policies]
    flights = {}
    for scenario, policy in (bar := tqdm(cells, unit="cell", leave=False)):
        bar.set_description(f"{policy} in {scenario}")
        flights[scenario, policy] = fly(policies[policy], scenario, episodes, seed)
    return Comparison(tuple(policies), tuple(scenarios), episodes, seed, flights)
