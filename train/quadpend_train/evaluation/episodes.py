"""Run policies through the same episodes and compute their metrics.

Start, reference and wind of episode k of a scenario depend on the seed and on k only. So every policy runs through the
same episodes, and differences can be computed episode by episode.
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

# First seeds of disjoint sets of episodes. The seeds of training runs are above 2³², see
# `quadpend_train.training.callbacks.first_seed`.
TEST_SEED = 1_000_000  # of the published results
TUNING_SEED = 2_000_000  # for the tuning of the classical controllers
VALIDATION_SEED = 3_000_000  # for daily use, and for the evaluations during training, which select the best policy
SETTLED_STEP = 500  # first step of the settled RMSE, after which the start has little influence
FALL_ERROR = 1.0  # m, RMSE that a fall counts as, and the upper limit of the penalised RMSE


class EpisodeResults(NamedTuple):
    """Metrics of n episodes for s policies: the training seeds of one learner, or one controller.

    A fall is an early termination. An episode without a fall is survived: it lasts 1000 steps.

    Attributes:
        survived: Whether the episode was survived, shape (s, n).
        steps: Number of steps of the episode, shape (s, n).
        rmse: Root mean square of the norm of the tracking error over these steps, m, shape (s, n).
        penalised_rmse: `rmse`, but at most 1 m, and 1 m for a fall, so that falling is never better than surviving; m,
            shape (s, n).
        settled_rmse: Root mean square of the error from step 500 on, m; nan for a fall; shape (s, n).
        largest_tilt: Largest angle of the pendulum from upright, rad, shape (s, n).
        effort: Root mean square of the norm of the action, shape (s, n).
        episode_return: Sum of the rewards, shape (s, n).
        error: Norm of the tracking error after each step, m; nan after a fall; shape (s, n, 1000).
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
    """Run `episodes` episodes with each policy; episode k has the seed `seed` + k.

    Args:
        policies: Objects with the `predict` protocol: one, or one for each training seed.
        scenario: Scenario, or its name as `find_scenario` takes it.
        episodes: Number of episodes.
        seed: Seed of the first episode.
        options: Options of the environment's reset, such as a start for each episode.

    Raises:
        ValueError: If the scenario is unknown, or its control period is not 0.01 s.
    """
    if isinstance(scenario, str):
        scenario = find_scenario(scenario)
    if scenario.simulation.period != CONTROL_PERIOD:
        raise ValueError(
            f"the control period of an evaluated scenario must be {CONTROL_PERIOD:g} s, not"
            f" {scenario.simulation.period:g} s: the metrics are defined for {EPISODE_STEPS} steps of that period"
        )
    results = []
    for policy in policies:
        env = scenario.make_vec(episodes, AutoresetMode.SAME_STEP)
        results.append(collect_results(rollout(adapt_policy(policy, scenario), env, seed, options), episodes))
    return EpisodeResults(*(np.stack(parts) for parts in zip(*results, strict=True)))


def collect_results(rollout_steps: Iterable[RolloutStep], episodes: int) -> EpisodeResults:
    """Compute the metrics of a rollout of `episodes` sub-environments; the arrays have no axis for training seeds."""
    survived, steps = np.zeros(episodes, np.bool_), np.zeros(episodes, np.int64)
    error = np.full((EPISODE_STEPS, episodes), np.nan)
    tilt, effort, episode_return = np.zeros(episodes), np.zeros(episodes), np.zeros(episodes)
    for number, step in enumerate(rollout_steps):
        running = step.active
        error[number, running] = np.linalg.norm(step.tracking_error[running], axis=1)
        tilt[running] = np.fmax(tilt[running], step.tilt[running])
        effort[running] += np.sum(step.action[running].astype(np.float64) ** 2, axis=1)
        episode_return[running] += step.reward[running]
        steps += running
        survived |= step.survived
    rmse = np.sqrt(np.nansum(error**2, axis=0) / steps)
    settled = np.sqrt(np.mean(error[SETTLED_STEP:] ** 2, axis=0))
    return EpisodeResults(
        survived,
        steps,
        rmse,
        np.where(survived, np.minimum(rmse, FALL_ERROR), FALL_ERROR),
        np.where(survived, settled, np.nan),
        tilt,
        np.sqrt(effort / steps),
        episode_return,
        np.ascontiguousarray(error.T, np.float32),
    )
