"""Flying policies through the same episodes and measuring how well they do.

Episode k of a scenario (start, reference, wind) depends on the seed and on k only, so every policy meets the same
episodes and differences can be taken episode by episode.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from tqdm.auto import tqdm

from baselines import Policy
from quadpend_gym.arrays import Booleans, Floats
from train.origin import origin
from train.policies import seated
from train.scenarios import Scenario, find_scenario
from train.statistics import Interval, mean, paired_proportion, proportion

# Episodes that no training run sees, whose seeds are above 2³² (`train.train.first_episode`).
TEST_SEED = 1_000_000  # the published results'
VALIDATION_SEED = 2_000_000  # for everything that is tuned
SETTLED = 500  # control steps after which the start should no longer matter


class Flights(NamedTuple):
    """The same n episodes, flown by s policies that are one learner trained with s seeds, or by one controller.

    Attributes:
        survived: whether the episode lasted its 1000 steps, shape (s, n).
        rmse: root mean square of the tracking error's norm over the steps flown, m, shape (s, n).
        settled_rmse: the same from step 500 on, m; nan where the episode was not survived, shape (s, n).
        largest_tilt: of the pendulum from upright, rad, shape (s, n).
        effort: root mean square of the action's norm, shape (s, n).
        episode_return: sum of rewards, shape (s, n).
        error: norm of the tracking error at each step, nan after the end, m, shape (s, n, 1000).
    """

    survived: Booleans
    rmse: Floats
    settled_rmse: Floats
    largest_tilt: Floats
    effort: Floats
    episode_return: Floats
    error: Floats


def fly(policies: Sequence[Policy], scenario: str | Scenario, episodes: int = 100, seed: int = TEST_SEED) -> Flights:
    """Fly each policy through the first episode of each of `episodes` seeds, counting up from `seed`.

    Args:
        policies: anything that obeys the `predict` protocol: one, or one for each training seed.
        scenario: a scenario, or what `find_scenario` takes for one.
        episodes: how many.
        seed: of the first.

    Raises:
        ValueError: there is no such scenario.
    """
    if isinstance(scenario, str):
        scenario = find_scenario(scenario)
    flown = [_fly_one(seated(policy, scenario), scenario, episodes, seed) for policy in policies]
    length = max(flights.error.shape[-1] for flights in flown)
    padded = [
        flights._replace(
            error=np.pad(flights.error, ((0, 0), (0, length - flights.error.shape[-1])), constant_values=np.nan)
        )
        for flights in flown
    ]
    return Flights(*(np.stack(parts) for parts in zip(*padded, strict=True)))


def _fly_one(policy: Policy, scenario: Scenario, episodes: int, seed: int) -> Flights:
    """As `fly`, for one policy and without the axis of the seeds."""
    env = scenario.make_vec(episodes, AutoresetMode.SAME_STEP)
    observation, _ = env.reset(seed=seed)
    memory: Any = None
    started = np.ones(episodes, np.bool_)
    flying = np.ones(episodes, np.bool_)
    survived = np.zeros(episodes, np.bool_)
    columns: list[Floats] = []
    while flying.any():
        action, memory = policy.predict(observation, memory, started, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        started = terminated | truncated
        error, tilt = np.linalg.norm(info["tracking_error"], axis=1), info["tilt"].copy()
        if started.any():  # these rows' info is of their next episode
            final = info["final_info"]
            error[started] = np.linalg.norm(final["tracking_error"][started], axis=1)
            tilt[started] = final["tilt"][started]
        column = np.stack([error, tilt, np.linalg.norm(action, axis=1), reward])
        columns.append(np.where(flying, column, np.nan))
        survived |= flying & truncated & ~terminated
        flying &= ~started
    error, tilt, effort, rewards = np.stack(columns, axis=-1)
    return Flights(
        survived,
        np.sqrt(np.nanmean(error**2, axis=1)),
        _settled(error, survived),
        np.nanmax(tilt, axis=1),
        np.sqrt(np.nanmean(effort**2, axis=1)),
        np.nansum(rewards, axis=1),
        error,
    )


def _settled(error: Floats, survived: Booleans) -> Floats:
    settled = np.full(survived.shape, np.nan)
    if survived.any():
        settled[survived] = np.sqrt(np.mean(error[survived, SETTLED:] ** 2, axis=1))
    return settled


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
        "settled_rmse": mean(flights.settled_rmse),
        "largest_tilt": mean(flights.largest_tilt),
        "effort": mean(flights.effort),
        "return": mean(flights.episode_return),
    }
    return {name: Interval(*(_FACTOR[MEASURES[name][0]] * x for x in value)) for name, value in values.items()}


def differences(flights: Flights, other: Flights) -> dict[str, Interval]:
    """How far `flights` lies above `other`, with paired intervals: the same episodes, one minus the other.

    `other` is one policy, or has as many training seeds as `flights`.
    """
    pairs = {
        "rmse": flights.rmse - other.rmse,
        "settled_rmse": flights.settled_rmse - other.settled_rmse,
        "largest_tilt": flights.largest_tilt - other.largest_tilt,
        "effort": flights.effort - other.effort,
        "return": flights.episode_return - other.episode_return,
    }
    survival = Interval(*(100.0 * x for x in paired_proportion(flights.survived, other.survived)))
    return {"survival": survival, **{name: mean(_FACTOR[MEASURES[name][0]] * pair) for name, pair in pairs.items()}}


@dataclass(frozen=True)
class Comparison:
    """Every policy in every scenario.

    Attributes:
        policies: their names.
        scenarios: by their names.
        episodes: flown in each cell.
        seed: of the first episode.
        flights: by scenario and policy.
    """

    policies: tuple[str, ...]
    scenarios: dict[str, Scenario]
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
                    "measures": _plain(summarise(self.flights[scenario, policy])),
                    "minus_first": _plain(differences(self.flights[scenario, policy], first)),
                }
                for policy in self.policies
            }
        return {
            "origin": origin(),
            "episodes": self.episodes,
            "seed": self.seed,
            "units": {name: unit for name, (unit, _) in MEASURES.items()},
            "scenarios": {name: asdict(scenario) for name, scenario in self.scenarios.items()},
            "results": results,
        }

    def save(self, folder: Path) -> None:
        """Write `comparison.json` into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.as_data(), indent=1, allow_nan=False)
        (folder / "comparison.json").write_text(text + "\n", encoding="utf-8")


def _plain(intervals: dict[str, Interval]) -> dict[str, dict[str, float | None]]:
    """Intervals as JSON has them, which knows no nan."""
    return {
        name: {key: None if np.isnan(x) else x for key, x in interval._asdict().items()}
        for name, interval in intervals.items()
    }


def compare(
    policies: Mapping[str, Sequence[Policy]],
    scenarios: Sequence[str] | Mapping[str, str],
    episodes: int = 100,
    seed: int = TEST_SEED,
) -> Comparison:
    """Fly every policy through the same episodes of every scenario.

    Args:
        policies: by the names they shall have; under one name, a controller or the training seeds of one learner.
        scenarios: what `find_scenario` takes for scenarios; by the names they shall have, or under that.
        episodes: in each scenario.
        seed: of the first.

    Raises:
        ValueError: there is no policy or no scenario, one is unknown, a policy cannot fly in a scenario, or `episodes`
            is below 1.
    """
    if not policies or not scenarios:
        raise ValueError("there must be at least one policy and one scenario to compare")
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, not {episodes}")
    named = scenarios if isinstance(scenarios, Mapping) else {name: name for name in scenarios}
    found = {name: find_scenario(scenario) for name, scenario in named.items()}
    cells = [(scenario, policy) for scenario in found for policy in policies]
    for scenario, policy in cells:
        _check_flight(policy, policies[policy], scenario, found[scenario])
    flights = {}
    for scenario, policy in (bar := tqdm(cells, unit="cell", leave=False)):
        bar.set_description(f"{policy} in {scenario}")
        flights[scenario, policy] = fly(policies[policy], found[scenario], episodes, seed)
    return Comparison(tuple(policies), found, episodes, seed, flights)


def _check_flight(name: str, policies: Sequence[Policy], scenario: str, found: Scenario) -> None:
    """Try a policy on one observation of a scenario, before hours are flown in vain."""
    env = found.make_vec(1, AutoresetMode.SAME_STEP)
    observation, _ = env.reset(seed=0)
    try:
        for policy in policies:
            action, _ = seated(policy, found).predict(observation, None, np.ones(1, np.bool_), deterministic=True)
            env.step(action)
            observation, _ = env.reset(seed=0)
    except ValueError as error:
        raise ValueError(f"{name} cannot fly in {scenario}: {error}") from error
