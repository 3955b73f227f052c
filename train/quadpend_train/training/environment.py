"""The environment that a learner trains in."""

from collections.abc import Sequence
from typing import Any

from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_baselines import controller
from quadpend_baselines.hybrid.wrappers import VectorWithCompanion
from quadpend_gym.actuators import Rotors
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train.envs.action_repeat import ActionRepeat
from quadpend_train.envs.baseline_relative import BaselineRelativeReward
from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.scenarios import Scenario, expand, find_scenario
from quadpend_train.training.settings import TrainSettings


def concatenate_scenarios(scenarios: Sequence[Scenario], rows: int, steps: int = 1000) -> VectorEnv[Any, Any, Any]:
    """Scenarios in equal shares of `rows`, for episodes of `steps`."""
    envs = [scenario.make_vec(rows // len(scenarios), AutoresetMode.SAME_STEP, steps) for scenario in scenarios]
    return envs[0] if len(envs) == 1 else ConcatenatedVectorEnv(envs)


def add_policy_wrappers(env: VectorEnv[Any, Any, Any], settings: TrainSettings) -> VectorEnv[Any, Any, Any]:
    """`env` as the learner sees it: with its companion and its history."""
    if settings.companion:
        if any(
            isinstance(model, Rotors) for name in expand(settings.scenario) for model in find_scenario(name).actuators
        ):
            raise ValueError(
                f"{settings.companion} commands thrust and torques: it cannot fly along where rotors are commanded"
            )
        env = VectorWithCompanion(env, settings.companion, settings.steers, settings.authority, settings.caution)
    if settings.history > 1 or settings.history_actions:
        env = VectorHistoryWrapper(env, settings.history, settings.history_actions)
    return env


def scenarios_at(settings: TrainSettings, steps: int) -> tuple[str, ...]:
    """What is trained in after so many steps: a stage of the curriculum, or the scenarios of the run."""
    if steps >= settings.curriculum_steps:
        return settings.scenario
    return (settings.curriculum[steps * len(settings.curriculum) // settings.curriculum_steps],)


def check_curriculum(settings: TrainSettings) -> None:
    """Raise ValueError unless all stages can be flown by the same policy and companion: a `Mixture` of them."""
    names = expand((*settings.curriculum, *settings.scenario))
    concatenate_scenarios([find_scenario(name) for name in names], len(names))


def make_env(settings: TrainSettings, steps: int = 0) -> SB3VecEnv:
    """What is trained in after so many steps, as Stable-Baselines3 wants it."""
    scenarios = [find_scenario(name).rewarded(settings.reward) for name in expand(scenarios_at(settings, steps))]
    env = add_policy_wrappers(concatenate_scenarios(scenarios, settings.num_envs, settings.max_episode_steps), settings)
    if settings.paired:
        twin = concatenate_scenarios(scenarios, settings.num_envs, settings.max_episode_steps)
        beside = controller(settings.companion, scenarios[0].simulation)
        gamma = settings.gamma ** (1.0 / settings.hold)
        env = BaselineRelativeReward(env, twin, beside, gamma, settings.failure_penalty)
    if settings.hold > 1:
        env = ActionRepeat(env, settings.hold)
    return SB3VecEnv(env, settings.reward_scale)
