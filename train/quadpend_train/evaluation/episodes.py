"""Run policies through the same episodes and compute their metrics.

Start, reference and wind of episode k of a scenario depend on the seed and on k only. So every policy runs through the
same episodes, and differences can be computed episode by episode.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from quadpend_baselines.policy.rollout import RolloutStep, rollout
from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.scenarios import Scenario, find_scenario
from quadpend_gym.vehicles import CONTROL_PERIOD
from quadpend_train.policies.conversion import as_policy

# First seeds of disjoint sets of episodes. The seeds of training runs are above 2³², see
# `quadpend_train.training.callbacks.first_seed`.
TEST_SEED = 1_000_000  # of results: the published ones, and the default of evaluations; these episodes select nothing
TUNING_SEED = 2_000_000  # for the tuning of the classical controllers
VALIDATION_SEED = 3_000_000  # for the evaluations during training, which select the best policy
FALL_ERROR = 1.0  # m, RMSE that a fall counts as, and the upper limit of the penalised RMSE


class EpisodeResults(NamedTuple):
    """Metrics of n episodes for s policies: the training seeds of one learner, or one controller.

    A fall is an early termination. An episode without a fall is survived: it lasts for the duration of the scenario,
    which is `Scenario.steps` control steps (T). Its scored steps are those after `Scenario.unscored`, by default all.

    Attributes:
        survived: Whether the episode was survived, shape (s, n).
        steps: Number of steps of the episode, shape (s, n).
        rmse: Root mean square of the error over the scored ones of these steps, m, shape (s, n); nan without any. The
            error is the norm of the tracking error. In tasks with `RewardWeights.pendulum_first`, where the pendulum is
            first to be brought to its side, the distance of the bob from its place relative to the quadrotor is added
            as another component.
        penalised_rmse: `rmse`, but at most 1 m, and 1 m for a fall, so that falling is never better than surviving; m,
            shape (s, n).
        settled_rmse: Root mean square of the error over the second half of the episode, in which the start has little
            influence, or over the scored steps if not all are scored, m; nan for a fall; shape (s, n).
        largest_tilt: Largest angle of the pendulum from its side, rad, shape (s, n).
        effort: Root mean square of the norm of the action, shape (s, n).
        action_rate: Root mean square of the norm of the change of the action in a step, divided by the control period,
            1/s, shape (s, n).
        cause: Why the episode fell, a place in `quadpend_gym.envs.outcome.CAUSES`; 0 if it survived; shape (s, n).
        episode_return: Sum of the rewards times the control period divided by 0.01 s, shape (s, n). So it is at most
            100 for each second of an episode at any control period, and the plain sum at the default control period.
        error: Error after each step, as in `rmse`, m; nan after a fall; shape (s, n, T).
    """

    survived: Booleans
    steps: Integers
    rmse: Floats
    penalised_rmse: Floats
    settled_rmse: Floats
    largest_tilt: Floats
    effort: Floats
    action_rate: Floats
    cause: Integers
    episode_return: Floats
    error: Floats32


def run_episodes(
    policies: Sequence[Any],
    scenario: str | Scenario,
    episodes: int = 100,
    seed: int = TEST_SEED,
    options: dict[str, Any] | None = None,
    known: Scenario | None = None,
    enough: float = np.inf,
) -> EpisodeResults:
    """Run `episodes` episodes with each policy; episode k has the seed `seed` + k.

    The policies, or what `as_policy` takes, are one controller or the training seeds of one learner. `options` are
    those of the environment's reset, such as a start for each episode. The policies are designed for the scenario
    `known`, by default the one that they fly.

    All stop in the step in which the number of falls of all policies reaches `enough`, and later policies do not fly.
    Episodes that have not ended then are not survived and have no cause.
    """
    scenario = find_scenario(scenario)
    results, lengths = [], np.full(episodes, scenario.steps)
    for policy in policies:
        flown = as_policy(policy).adapt(known or scenario)
        env = flown.wrap(scenario.make_vec(episodes, AutoresetMode.SAME_STEP))
        steps = _until(rollout(flown, env, seed, options), enough)
        arguments = lengths, scenario.period, pendulum_arm(scenario), scenario.unscored_steps
        results.append(collect_results(steps, *arguments))
        enough -= np.count_nonzero(results[-1].cause)
        if enough <= 0:
            break
    return EpisodeResults(*(np.stack(parts) for parts in zip(*results, strict=True)))


def _until(steps: Iterable[RolloutStep], falls: float) -> Iterator[RolloutStep]:
    """Yield steps up to the one in which the number of falls is reached."""
    for step in steps:
        yield step
        falls -= np.count_nonzero(step.cause[step.active])
        if falls <= 0:
            return


def pendulum_arm(scenario: Scenario) -> float:
    """Return the length by which the error counts a wrong direction of the pendulum, m: that of the rod, or 0."""
    counts = scenario.task.reward.pendulum_first > 0.0
    return scenario.simulation.parameters.rod_length if counts else 0.0


def collect_results(
    rollout_steps: Iterable[RolloutStep], lengths: Integers, period: float, arm: float = 0.0, unscored: Any = 0
) -> EpisodeResults:
    """Compute the metrics of a rollout of n sub-environments; the arrays have no axis for training seeds.

    Their episodes are truncated after `lengths` steps, shape (n,). `period` is the control period, s, and `arm` that of
    `pendulum_arm`, m. `unscored` is the number of steps at the beginning whose errors do not count, or one for each.
    """
    episodes = len(lengths)
    survived, steps = np.zeros(episodes, np.bool_), np.zeros(episodes, np.int64)
    error = np.full((lengths.max(), episodes), np.nan)
    tilt, effort, changes, episode_return = (np.zeros(episodes) for _ in range(4))
    cause, previous = np.zeros(episodes, np.int64), np.zeros(0)
    for number, step in enumerate(rollout_steps):
        running = step.active
        size = np.linalg.norm(step.tracking_error[running], axis=1)
        error[number, running] = np.hypot(size, 2.0 * arm * np.sin(0.5 * step.tilt[running])) if arm else size
        tilt[running] = np.fmax(tilt[running], step.tilt[running])
        action = step.action.astype(np.float64)
        effort[running] += np.sum(action[running] ** 2, axis=1)
        changes[running] += np.sum((action - (previous if number else action))[running] ** 2, axis=1)
        previous = action
        cause[running] = step.cause[running]
        episode_return[running] += step.reward[running]
        steps += running
        survived |= step.survived
    unscored = np.broadcast_to(unscored, episodes)
    scored = np.where(np.arange(len(error))[:, np.newaxis] >= unscored, error, np.nan)
    rmse = np.sqrt(np.nansum(scored**2, axis=0) / np.where(steps > unscored, steps - unscored, np.nan))
    settled, begins = np.empty(episodes), np.where(unscored > 0, unscored, lengths // 2)
    for begin, length in set(zip(begins.tolist(), lengths.tolist(), strict=True)):
        rows = (begins == begin) & (lengths == length)
        settled[rows] = np.sqrt(np.mean(np.compress(rows, error[begin:length], axis=1) ** 2, axis=0))
    return EpisodeResults(
        survived,
        steps,
        rmse,
        np.where(survived, np.minimum(rmse, FALL_ERROR), FALL_ERROR),
        np.where(survived, settled, np.nan),
        tilt,
        np.sqrt(effort / steps),
        np.sqrt(changes / np.maximum(steps - 1, 1)) / period,
        cause,
        episode_return * (period / CONTROL_PERIOD),
        np.ascontiguousarray(error.T, np.float32),
    )
