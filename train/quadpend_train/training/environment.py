"""Create the training environment from settings: scenarios, hybrid, history, reward and action repeat."""

from collections.abc import Sequence
from typing import Any

from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_baselines import controller
from quadpend_baselines.hybrid import VectorHybridWrapper, hybrid_from_data
from quadpend_gym import RewardWeights
from quadpend_gym.actuators import Rotors
from quadpend_gym.physics.parameters import CONTROL_PERIOD
from quadpend_gym.wrappers import VectorHistoryWrapper
from quadpend_train.envs.action_repeat import ActionRepeat
from quadpend_train.envs.baseline_relative import BaselineRelativeReward
from quadpend_train.envs.concatenated import ConcatenatedVectorEnv
from quadpend_train.envs.sb3_vec_env import SB3VecEnv
from quadpend_train.scenarios import Scenario, expand_sets, find_scenario
from quadpend_train.training.settings import TrainSettings


def concatenate_scenarios(
    scenarios: Sequence[Scenario], num_envs: int, max_episode_steps: int | None = None
) -> VectorEnv[Any, Any, Any]:
    """Return one vector environment with an equal number of sub-environments of each scenario and same-step autoreset.

    Args:
        scenarios: The scenarios.
        num_envs: Number of sub-environments in all, a multiple of the number of scenarios.
        max_episode_steps: Control steps after which an episode is truncated; None: those of each scenario.

    Raises:
        ValueError: If the scenarios have different observations or different nominal simulations.
    """
    share = num_envs // len(scenarios)
    envs = [scenario.make_vec(share, AutoresetMode.SAME_STEP, max_episode_steps) for scenario in scenarios]
    return envs[0] if len(envs) == 1 else ConcatenatedVectorEnv(envs)


def add_policy_wrappers(env: VectorEnv[Any, Any, Any], settings: TrainSettings) -> VectorEnv[Any, Any, Any]:
    """Wrap `env` with the hybrid and the history of the settings.

    Raises:
        TypeError: If the base controller does not support the hybrid's mode.
        ValueError: If a scenario has rotors as actuators, which base controllers cannot command, or the hybrid does not
            accept the observation of `env`.
    """
    if data := settings.hybrid.as_data():
        names = expand_sets((*settings.curriculum, *settings.scenarios))
        models = [model for name in names for model in find_scenario(name).actuators]
        if any(isinstance(model, Rotors) for model in models):
            raise ValueError(
                f"the base controller {settings.hybrid.base_controller} commands thrust and torques: it cannot be part"
                " of a hybrid in a scenario with rotors as actuators"
            )
        env = VectorHybridWrapper(env, hybrid_from_data(data))
    if settings.history > 1 or settings.history_actions:
        env = VectorHistoryWrapper(env, settings.history, settings.history_actions)
    return env


def scenarios_at(settings: TrainSettings, timesteps: int) -> tuple[str, ...]:
    """Return the scenarios at a timestep of the training: those of a stage of the curriculum, or those of the run."""
    if timesteps >= settings.curriculum_steps:
        return settings.scenarios
    return (settings.curriculum[timesteps * len(settings.curriculum) // settings.curriculum_steps],)


def check_curriculum(settings: TrainSettings) -> None:
    """Check that one policy and one base controller fit all stages of the curriculum.

    Raises:
        ValueError: If the stages have different observations or different nominal simulations.
    """
    names = expand_sets((*settings.curriculum, *settings.scenarios))
    concatenate_scenarios([find_scenario(name) for name in names], len(names))


def _with_reward(scenario: Scenario, reward: RewardWeights) -> Scenario:
    """Return the scenario with the reward weights of the settings; the default weights keep those of the scenario."""
    return scenario if reward == RewardWeights() else scenario.with_reward(reward)


def make_env(settings: TrainSettings, timesteps: int = 0) -> SB3VecEnv:
    """Return the training environment for Stable-Baselines3 at a timestep of the training."""
    names = expand_sets(scenarios_at(settings, timesteps))
    scenarios = [_with_reward(find_scenario(name), settings.reward) for name in names]
    steps, hybrid = settings.max_episode_steps or None, settings.hybrid
    env = add_policy_wrappers(concatenate_scenarios(scenarios, settings.num_envs, steps), settings)
    if hybrid.baseline_relative_reward:
        baseline, simulation = concatenate_scenarios(scenarios, settings.num_envs, steps), scenarios[0].simulation
        base_controller = controller(hybrid.base_controller, simulation)
        gamma = settings.gamma ** (1.0 / hybrid.action_repeat)  # discount factor of a control step
        # A penalty of c is the largest return of c steps of the default period: of the same time at any period.
        penalty = hybrid.failure_penalty * (CONTROL_PERIOD / simulation.period)
        env = BaselineRelativeReward(env, baseline, base_controller, gamma, penalty)
    if hybrid.action_repeat > 1:
        env = ActionRepeat(env, hybrid.action_repeat)
    return SB3VecEnv(env, settings.reward_scale)
