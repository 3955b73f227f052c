"""Wrappers that add the latest observations and actions to the observation of an environment.

Each wrapper exists for a single environment and, with the prefix ``Vector``, for a vector environment.

The specification of a single environment contains its wrappers and can be converted to JSON with them. The
specification of a vector environment contains no wrappers, as with Gymnasium's own vector wrappers. Env and VectorEnv
return the same numbers for the same seed.

With same-step autoreset, `step` returns the first observation of the next episode for each sub-environment whose
episode ended. The last observation of the ended episode is in ``info["final_obs"]``, an object array of shape (n,) that
holds None for the other sub-environments. A wrapper that changes observations must change both, see
`last_observations`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from quadpend_gym.core.arrays import Booleans, Floats32
from quadpend_gym.core.settings import plain
from quadpend_gym.envs.spaces import meaning_of, observation_space


def last_observations(observation: Floats32, info: dict[str, Any], ended: Booleans) -> Floats32:
    """Return the observations, shape (n, k), that the last step reached, before any same-step autoreset.

    `observation` and `info` are those that `step` returned, and `ended` the mask of the ended episodes, shape (n,).
    """
    if "final_obs" not in info:
        return observation
    last = observation.copy()
    last[ended] = np.stack(info["final_obs"][ended])
    return last


def replace_final_observations(info: dict[str, Any], ended: Booleans, last: Floats32) -> None:
    """Set ``info["final_obs"]`` and its mask ``info["_final_obs"]``, to the last observations, shape (n, k)."""
    final = np.empty(ended.size, object)  # filled with None
    for row in np.flatnonzero(ended):
        final[row] = last[row].copy()
    info["final_obs"], info["_final_obs"] = final, ended


class _Histories:
    """The latest observations and actions of n sub-environments, oldest first."""

    def __init__(self, num_envs: int, observations: int, actions: int, seen: Any, acted: Any) -> None:
        if observations < 1 or actions < 0 or (observations, actions) == (1, 0):
            raise ValueError(
                f"a history must have 2 or more observations, or 1 or more actions, not {observations} and {actions}"
            )
        self._observations = np.zeros((num_envs, observations, *seen.shape), np.float32)
        self._actions = np.zeros((num_envs, actions, *acted.shape), np.float32)

    @property
    def size(self) -> int:
        """Size of the history of one sub-environment."""
        return int(np.prod(self._observations.shape[1:]) + np.prod(self._actions.shape[1:]))

    def start(self, started: Booleans, observation: Floats32) -> None:
        """Fill the histories of the episodes that `started` with their first observation and with zero actions."""
        self._observations[started] = observation[started, np.newaxis]
        self._actions[started] = 0.0

    def push(self, observation: Floats32, action: Floats32) -> None:
        """Append an action and the observation that followed it, and drop the oldest ones."""
        for memory, value in ((self._observations, observation), (self._actions, action)):
            if memory.shape[1]:
                memory[:, :-1] = memory[:, 1:]
                memory[:, -1] = value

    def flat(self) -> Floats32:
        """Return the observations followed by the actions, shape (n, size)."""
        n = self._observations.shape[0]
        return np.concatenate([self._observations.reshape(n, -1), self._actions.reshape(n, -1)], axis=1)


class HistoryWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Stack the latest observations, the current one included, and actions, for policies without memory.

    The observations come first, then the actions, both with the oldest first. At the start of an episode the history
    holds copies of the first observation and zero actions.
    """

    def __init__(self, env: gym.Env[Any, Any], observations: int = 4, actions: int = 0) -> None:
        observations, actions = plain(observations), plain(actions)  # JSON of a specification takes no NumPy numbers
        RecordConstructorArgs.__init__(self, observations=observations, actions=actions)
        gym.Wrapper.__init__(self, env)
        self._histories = _Histories(1, observations, actions, env.observation_space, env.action_space)
        meaning = {**meaning_of(env.observation_space), "history": (observations, actions)}
        self.observation_space = observation_space(self._histories.size, **meaning)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Start an episode and its history."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._histories.start(np.ones(1, np.bool_), observation[np.newaxis])
        return self._histories.flat()[0], info

    def step(self, action: Any) -> tuple[Floats32, Any, bool, bool, dict[str, Any]]:
        """Step the wrapped environment and return the history as the observation."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._histories.push(observation[np.newaxis], np.asarray(action)[np.newaxis])
        return self._histories.flat()[0], reward, terminated, truncated, info


class VectorHistoryWrapper(VectorWrapper):
    """`HistoryWrapper` for a vector environment, in every autoreset mode."""

    def __init__(self, env: VectorEnv[Any, Any, Any], observations: int = 4, actions: int = 0) -> None:
        VectorWrapper.__init__(self, env)
        spaces_of_one = env.single_observation_space, env.single_action_space
        self._histories = _Histories(self.num_envs, observations, actions, *spaces_of_one)
        self._ended = np.zeros(self.num_envs, np.bool_)
        meaning = {**meaning_of(env.single_observation_space), "history": (observations, actions)}
        self.single_observation_space = observation_space(self._histories.size, **meaning)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Floats32, dict[str, Any]]:
        """Start an episode and its history in every sub-environment that is reset."""
        mask = (options or {}).get("reset_mask")  # before the reset, which removes it from the options
        observation, info = self.env.reset(seed=seed, options=options)
        started = np.ones(self.num_envs, np.bool_) if mask is None else mask
        self._histories.start(started, observation)
        self._ended = self._ended & ~started
        return self._histories.flat(), info

    def step(self, actions: Any) -> tuple[Floats32, Any, Any, Any, dict[str, Any]]:
        """Step the wrapped environment and return the histories as the observations."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        self._histories.push(last_observations(observation, info, ended), np.asarray(actions, np.float32))
        if "final_obs" in info:
            replace_final_observations(info, ended, self._histories.flat())
            self._histories.start(ended, observation)
        elif self.metadata.get("autoreset_mode") is AutoresetMode.NEXT_STEP:
            self._histories.start(self._ended, observation)
        self._ended = ended
        return self._histories.flat(), reward, terminated, truncated, info
