"""Flying policies through the same episodes and measuring how well they do.

Episode k of a scenario (start, reference, wind) depends on the seed and on k only, so every policy meets the same
episodes and differences can be taken episode by episode.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy
from quadpend_baselines.policy.rollout import RolloutStep, rollout
from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.physics.parameters import CONTROL_PERIOD
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_train.policies.adaptation import adapt_policy
from quadpend_train.scenarios import Scenario, find_scenario

# Blocks of episodes, which no training run sees: its seeds are above 2³² (`quadpend_train.training.train.first_episode`).
TEST_SEED = 1_000_000  # the published results'
TUNING_SEED = 2_000_000  # those that classical gains are searched on
VALIDATION_SEED = 3_000_000  # for everybody's daily use: neither tuned on nor published
STEPS, PERIOD = EPISODE_STEPS, CONTROL_PERIOD
SETTLED = 500  # steps after which the start should no longer matter
FALL = 1.0  # m, the tracking error that a fall counts as, and nothing counts more


class EpisodeResults(NamedTuple):
    """The same n episodes, flown by s policies that are one learner trained with s seeds, or by one controller.

    Attributes:
        survived: whether the episode lasted its 1000 steps, shape (s, n).
        steps: flown, shape (s, n).
        rmse: root mean square of the tracking error's norm over the steps flown, m, shape (s, n).
        penalised_rmse: the same, but that a fall counts as 1 m, and nothing as more, so that nobody gains by falling,
            shape (s, n).
        settled_rmse: over the steps from 500 on, m; nan where the episode was not survived, shape (s, n).
        largest_tilt: of the pendulum from upright, rad, shape (s, n).
        effort: root mean square of the action's norm, shape (s, n).
        episode_return: sum of rewards, shape (s, n).
        error: norm of the tracking error after each step, nan where none was flown, m, shape (s, n, 1000).
    """

    survived: Booleans
    steps: Integers
    rmse: Floats
    penalised_rmse: Floats
    settled_rmse: Floats
    largest_tilt: Floats
    effort: Floats
    episode_return: Floats
    error: Floats32


def run_episodes(
    policies: Sequence[Policy],
    scenario: str | Scenario,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    options: dict[str, Any] | None = None,
) -> EpisodeResults:
    """Fly each policy through the first episode of each of `episodes` seeds, counting up from `seed`.

    Args:
        policies: anything that obeys the `predict` protocol: one, or one for each training seed.
        scenario: a scenario, or what `find_scenario` takes for one.
        episodes: how many.
        seed: of the first.
        options: of the environment's reset, such as a start of each episode's own.

    Raises:
        ValueError: there is no such scenario, or its control period is another than the measures are made for.
    """
    if isinstance(scenario, str):
        scenario = find_scenario(scenario)
    if scenario.simulation.period != PERIOD:
        raise ValueError(
            f"flights are measured over {STEPS} steps of {PERIOD:g} s, not {scenario.simulation.period:g} s"
        )
    flown = []
    for policy in policies:
        env = scenario.make_vec(episodes, AutoresetMode.SAME_STEP)
        flown.append(collect_results(rollout(adapt_policy(policy, scenario), env, seed, options), episodes))
    return EpisodeResults(*(np.stack(parts) for parts in zip(*flown, strict=True)))


def collect_results(steps_flown: Iterable[RolloutStep], episodes: int) -> EpisodeResults:
    """The measures of a rollout of `episodes` rows, without the axis of the seeds."""
    survived, steps = np.zeros(episodes, np.bool_), np.zeros(episodes, np.int64)
    error = np.full((STEPS, episodes), np.nan)
    tilt, effort, gained = np.zeros(episodes), np.zeros(episodes), np.zeros(episodes)
    for number, step in enumerate(steps_flown):
        flying = step.active
        error[number, flying] = np.linalg.norm(step.tracking_error[flying], axis=1)
        tilt[flying] = np.fmax(tilt[flying], step.tilt[flying])
        effort[flying] += np.sum(step.action[flying].astype(np.float64) ** 2, axis=1)
        gained[flying] += step.reward[flying]
        steps += flying
        survived |= step.survived
    rmse = np.sqrt(np.nansum(error**2, axis=0) / steps)
    settled = np.sqrt(np.mean(error[SETTLED:] ** 2, axis=0))
    return EpisodeResults(
        survived,
        steps,
        rmse,
        np.where(survived, np.minimum(rmse, FALL), FALL),
        np.where(survived, settled, np.nan),
        tilt,
        np.sqrt(effort / steps),
        gained,
        np.ascontiguousarray(error.T, np.float32),
    )
