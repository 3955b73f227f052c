"""Action repeat: the environment makes several steps for each action of the learner."""

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_gym.wrappers import last_observations, replace_final_observations


class ActionRepeat(VectorWrapper):
    """Apply every action for several `steps` of an environment with same-step autoreset, and sum their rewards.

    A sub-environment whose episode ends during the repeats resets at once. For the remaining repeats it receives zero
    actions, whose rewards are not counted. For a hybrid, a zero action is the base controller alone.

    The info is that of the last of the repeated steps; only ``final_obs`` is collected over all of them.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], steps: int) -> None:
        VectorWrapper.__init__(self, env)
        self._steps = steps

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every sub-environment several times with its action."""
        reward_sum, running = np.zeros(self.num_envs), np.ones(self.num_envs, np.bool_)
        any_terminated, any_truncated = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        last = np.zeros(self.observation_space.shape or (), np.float32)
        observation: Any = None
        info: dict[str, Any] = {}
        for _ in range(self._steps):
            repeated = np.where(running[:, np.newaxis], actions, np.float32(0.0))
            observation, reward, terminated, truncated, info = self.env.step(repeated)
            reward_sum += running * reward
            if (ended := running & (terminated | truncated)).any():
                last[ended] = last_observations(observation, info, terminated | truncated)[ended]
                any_terminated |= ended & terminated
                any_truncated |= ended & truncated
                running &= ~ended
        info = dict(info)
        replace_final_observations(info, ~running, last)
        return observation, reward_sum, any_terminated, any_truncated, info
