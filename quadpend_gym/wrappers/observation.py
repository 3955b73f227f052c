"""What a policy gets to see: outputs without velocities, and a memory for the memoryless."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from quadpend_gym.core.arrays import Booleans, Floats32
from quadpend_gym.core.validation import check_int
from quadpend_gym.envs.spaces import observation_space
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS, OUTPUT_FEEDBACK_SIZE
from quadpend_gym.wrappers.same_step import last_observations, replace_final_observations


def _size(space: Any, name: str) -> int:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise TypeError(f"the {name} must be a vector of numbers, not {space}")
    return int(space.shape[0])


def _check_layout(space: Any) -> None:
    if (size := _size(space, "observation")) != OBSERVATION_SIZE:
        raise ValueError(
            f"velocities can only be hidden from the whole observation of {OBSERVATION_SIZE} numbers, not from"
            f" {size}: put OutputFeedbackWrapper once, and inside HistoryWrapper"
        )


class OutputFeedbackWrapper(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Hide every velocity of `env`: 27 numbers are left, which is what the paper's controller has.

    Error, direction, attitude and the reference's derivatives keep their order; `read_observation` reads them, and says
    so when it is asked for a velocity.

    Args:
        env: a QuadPendulum environment.

    Raises:
        TypeError: the observation of `env` is no vector.
        ValueError: the observation of `env` is not the whole one.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        _check_layout(env.observation_space)
        self.observation_space = observation_space(OUTPUT_FEEDBACK_SIZE)

    def observation(self, observation: Floats32) -> Floats32:
        """The observation without velocities, shape (27,)."""
        return np.asarray(observation[OUTPUT_FEEDBACK_COLUMNS])


class VectorOutputFeedbackWrapper(VectorWrapper):
    """`OutputFeedbackWrapper` for a vector environment, in every autoreset mode."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        _check_layout(env.single_observation_space)
        self.single_observation_space = observation_space(OUTPUT_FEEDBACK_SIZE)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Floats32, dict[str, Any]]:
        """As the environment's, without velocities."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation[:, OUTPUT_FEEDBACK_COLUMNS], info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As the environment's, without velocities."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        if "final_obs" in info:
            ended = terminated | truncated
            last = last_observations(observation, info, ended)
            replace_final_observations(info, ended, last[:, OUTPUT_FEEDBACK_COLUMNS])
        return observation[:, OUTPUT_FEEDBACK_COLUMNS], reward, terminated, truncated, info


class _Histories:
    """The latest observations and actions of n rows, oldest first."""

    def __init__(self, rows: int, observations: int, actions: int, sizes: tuple[int, int]) -> None:
        check_int(observations, "observations", 1)
        check_int(actions, "actions", 0)
        if observations == 1 and actions == 0:
            raise ValueError("one observation and no action is no history: ask for more of either")
        self._observations = np.zeros((rows, observations, sizes[0]), np.float32)
        self._actions = np.zeros((rows, actions, sizes[1]), np.float32)

    @property
    def size(self) -> int:
        """Numbers of a row."""
        return int(np.prod(self._observations.shape[1:]) + np.prod(self._actions.shape[1:]))

    def begin(self, rows: Booleans, observation: Floats32) -> None:
        """Fill the histories of some rows with their first observation, and with hovering."""
        self._observations[rows] = observation[rows, np.newaxis]
        self._actions[rows] = 0.0

    def push(self, observation: Floats32, action: Floats32) -> None:
        """Remember what was done and what came of it; forget the oldest."""
        for memory, value in ((self._observations, observation), (self._actions, action)):
            if memory.shape[1]:
                memory[:, :-1] = memory[:, 1:]
                memory[:, -1] = value

    def flat(self) -> Floats32:
        """Observations, then actions, shape (n, size)."""
        rows = self._observations.shape[0]
        return np.concatenate([self._observations.reshape(rows, -1), self._actions.reshape(rows, -1)], axis=1)


class HistoryWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Observe the latest observations and actions side by side, so that a memoryless policy can infer what is hidden.

    The oldest comes first. An episode begins as if its first observation had always been, in hover.

    Args:
        env: an environment whose observations and actions are vectors.
        observations: how many, the present one among them.
        actions: how many of the actions that led to the present.

    Raises:
        TypeError: the observations or actions of `env` are no vectors.
        ValueError: a number is out of range.
    """

    def __init__(self, env: gym.Env[Any, Any], observations: int = 4, actions: int = 0) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, observations=observations, actions=actions)
        gym.Wrapper.__init__(self, env)
        sizes = _size(env.observation_space, "observation"), _size(env.action_space, "action")
        self._histories = _Histories(1, observations, actions, sizes)
        self.observation_space = observation_space(self._histories.size)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode, and a history."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._histories.begin(np.ones(1, np.bool_), observation[np.newaxis])
        return self._histories.flat()[0], info

    def step(self, action: Any) -> tuple[Floats32, Any, bool, bool, dict[str, Any]]:
        """Act, and remember."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._histories.push(observation[np.newaxis], np.asarray(action)[np.newaxis])
        return self._histories.flat()[0], reward, terminated, truncated, info


class VectorHistoryWrapper(VectorWrapper):
    """`HistoryWrapper` for a vector environment, in every autoreset mode."""

    def __init__(self, env: VectorEnv[Any, Any, Any], observations: int = 4, actions: int = 0) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        sizes = _size(env.single_observation_space, "observation"), _size(env.single_action_space, "action")
        self._histories = _Histories(self.num_envs, observations, actions, sizes)
        self._ended = np.zeros(self.num_envs, np.bool_)
        self.single_observation_space = observation_space(self._histories.size)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode, and a history, in every row that is reset."""
        mask = (options or {}).get("reset_mask")  # which other vector environments take out of the options
        observation, info = self.env.reset(seed=seed, options=options)
        begun = np.ones(self.num_envs, np.bool_) if mask is None else mask
        self._histories.begin(begun, observation)
        self._ended = self._ended & ~begun
        return self._histories.flat(), info

    def step(self, actions: Any) -> tuple[Floats32, Any, Any, Any, dict[str, Any]]:
        """Act, and remember."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        self._histories.push(last_observations(observation, info, ended), np.asarray(actions, np.float32))
        if "final_obs" in info:
            replace_final_observations(info, ended, self._histories.flat())
            self._histories.begin(ended, observation)
        elif self.metadata.get("autoreset_mode") is AutoresetMode.NEXT_STEP and self._ended.any():
            self._histories.begin(self._ended, observation)
        self._ended = ended
        return self._histories.flat(), reward, terminated, truncated, info
