"""Create the training environment from settings: scenarios, hybrid and reward."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_baselines import controller
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid import VectorHybridWrapper, hybrid_from_data
from quadpend_gym import RewardWeights
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK
from quadpend_gym.vehicles import CONTROL_PERIOD
from quadpend_train.envs.baseline_relative import BaselineRelativeReward
from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.training.settings import TrainSettings


def concatenate_scenarios(
    scenarios: Sequence[Scenario],
    num_envs: int,
    max_episode_steps: int | None = None,
    hybrid: Mapping[str, Any] | None = None,
    teaches: bool = False,
) -> VectorEnv[Any, Any, Any]:
    """Return one vector environment with an equal number of sub-environments of each scenario and same-step autoreset.

    Neighbouring scenarios share a hybrid if they have the same nominal simulation, delays and lags, which base
    controllers know as in evaluation. The scenarios have the same observation.
    """
    share = num_envs // len(scenarios)
    envs = [
        scenario.make_vec(share, AutoresetMode.SAME_STEP, max_episode_steps=max_episode_steps) for scenario in scenarios
    ]
    if not hybrid:
        return _concatenated(envs)
    made, pairs = hybrid_from_data(hybrid), zip(scenarios, envs, strict=True)
    groups = groupby(pairs, lambda pair: (pair[0].simulation, Loop.known(pair[0])))
    parts = [(_concatenated([env for _, env in group]), loop) for (_, loop), group in groups]
    return _concatenated([VectorHybridWrapper(env, made, loop, teaches) for env, loop in parts])


def _concatenated(envs: Sequence[VectorEnv[Any, Any, Any]]) -> VectorEnv[Any, Any, Any]:
    return envs[0] if len(envs) == 1 else ConcatenatedVectorEnv(envs)


def hybrid_wrappers(env: Any) -> list[VectorHybridWrapper]:
    """Return the wrappers of the hybrids under a training environment, in the order of its rows, if there are any."""
    while not isinstance(env, VectorHybridWrapper | ConcatenatedVectorEnv):
        if not hasattr(env, "env"):
            return []
        env = env.env
    parts = env.envs if isinstance(env, ConcatenatedVectorEnv) else [env]
    return [part for part in parts if isinstance(part, VectorHybridWrapper)]


def _with_reward(scenario: Scenario, reward: RewardWeights) -> Scenario:
    """Return the scenario with the reward weights of the settings; the default weights keep those of the scenario.

    `pendulum_first` is not below that of the scenario, because it belongs to the task.
    """
    least = max(reward.pendulum_first, scenario.task.reward.pendulum_first)
    if reward == RewardWeights():
        return scenario
    return replace(scenario, task=replace(scenario.task, reward=replace(reward, pendulum_first=least)))


def observed_scenarios(settings: TrainSettings) -> list[Scenario]:
    """Return the scenarios of a run as its learner observes them: without an observer, errors in place of `LAB`."""
    data = settings.hybrid.as_data()
    if data is not None and hybrid_from_data(data).reads != "measurements":
        return list(settings.scenarios)
    return [
        replace(item, observation=OUTPUT_FEEDBACK) if item.observation == LAB else item for item in settings.scenarios
    ]


def make_env(settings: TrainSettings, teaches: bool = False) -> SB3VecEnv:
    """Return the training environment for Stable-Baselines3; `teaches`: its base controllers label for an imitation."""
    steps, hybrid = settings.max_episode_steps or None, settings.hybrid
    scenarios = [_with_reward(scenario, settings.reward) for scenario in observed_scenarios(settings)]
    env = concatenate_scenarios(scenarios, settings.num_envs, steps, hybrid.as_data(), teaches)
    if hybrid.baseline_relative_reward:
        baseline = concatenate_scenarios(scenarios, settings.num_envs, steps)
        base_controllers = [controller(hybrid.base_controller).adapt(scenario) for scenario in scenarios]
        # A penalty of c is the largest return of c steps of the default period: of the same time at any period.
        penalty = hybrid.failure_penalty * (CONTROL_PERIOD / scenarios[0].simulation.period)
        env = BaselineRelativeReward(env, baseline, base_controllers, settings.argument("gamma"), penalty)
    return SB3VecEnv(env, settings.reward_scale)
