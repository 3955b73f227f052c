"""The environment that a learner trains in."""

from collections.abc import Sequence
from typing import Any

from gymnasium.vector import AutoresetMode, VectorEnv

from baselines.wrappers import VectorWithCompanion
from quadpend_gym.wrappers import VectorHistoryWrapper
from train.mixture import Mixture
from train.sb3_vec_env import SB3VecEnv
from train.scenarios import expand, find_scenario
from train.settings import TrainSettings


def together(scenarios: Sequence[str], rows: int, steps: int = 1000) -> VectorEnv[Any, Any, Any]:
    """Scenarios, sets of them among them, in equal shares of `rows`, for episodes of `steps`."""
    found = [find_scenario(name) for name in expand(scenarios)]
    envs = [scenario.make_vec(rows // len(found), AutoresetMode.SAME_STEP, steps) for scenario in found]
    return envs[0] if len(envs) == 1 else Mixture(envs)


def seen(env: VectorEnv[Any, Any, Any], settings: TrainSettings) -> VectorEnv[Any, Any, Any]:
    """`env` as the learner sees it: with its companion and its history."""
    if settings.companion:
        env = VectorWithCompanion(env, settings.companion, settings.steers, settings.authority)
    if settings.history > 1 or settings.history_actions:
        env = VectorHistoryWrapper(env, settings.history, settings.history_actions)
    return env


def scenarios_at(settings: TrainSettings, steps: int) -> tuple[str, ...]:
    """What is trained in after so many steps: a stage of the curriculum, or the scenarios of the run."""
    if steps >= settings.curriculum_steps:
        return settings.scenario
    return (settings.curriculum[steps * len(settings.curriculum) // settings.curriculum_steps],)


def make_env(settings: TrainSettings, steps: int = 0) -> SB3VecEnv:
    """What is trained in after so many steps, as Stable-Baselines3 wants it."""
    env = together(scenarios_at(settings, steps), settings.num_envs, settings.episode_steps)
    return SB3VecEnv(seen(env, settings), settings.reward_scale)
