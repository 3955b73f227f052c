"""A learner that decides less often than the environment steps."""

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_gym.wrappers.same_step import last_observations, replace_final_observations


class ActionRepeat(VectorWrapper):
    """Hold every action for several steps of `env`, and add up the rewards.

    A row whose episode ends while an action is held begins the next one with zero actions, which is the companion alone
    for a learner that steers, until the learner decides again.

    Args:
        env: with same-step autoreset.
        steps: that an action is held.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], steps: int) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        self._steps = steps

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every row several times."""
        earned, deciding = np.zeros(self.num_envs), np.ones(self.num_envs, np.bool_)
        terminated, truncated = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        last = np.zeros(self.observation_space.shape or (), np.float32)
        observation: Any = None
        info: dict[str, Any] = {}
        for _ in range(self._steps):
            held = np.where(deciding[:, np.newaxis], actions, np.float32(0.0))
            observation, reward, fell, ran_out, info = self.env.step(held)
            earned += deciding * reward
            if (ended := deciding & (fell | ran_out)).any():
                last[ended] = last_observations(observation, info, fell | ran_out)[ended]
                terminated |= ended & fell
                truncated |= ended & ran_out
                deciding &= ~ended
        info = dict(info)
        replace_final_observations(info, ~deciding, last)
        return observation, earned, terminated, truncated, info
