"""Wrappers that put a hybrid around an environment, so that an agent learns or acts as its policy.

    env = HybridWrapper(gym.make("quadpend_gym:QuadPendulum-v0", wind="windy"), ResidualAction("flatness", 0.3))

`HybridWrapper` is for a single environment, `VectorHybridWrapper` for a vector environment in every autoreset mode.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.hybrids import Hybrid, HybridMemory, hybrid_from_data
from quadpend_baselines.policy.protocol import replace_rows
from quadpend_gym.core.arrays import Booleans, Floats32
from quadpend_gym.envs.inputs import check_action, clip_rounding
from quadpend_gym.envs.spaces import observation_space
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE
from quadpend_gym.wrappers.same_step import last_observations, replace_final_observations

NO_HYBRID = "hybrids balance an upright pendulum: the base controller does not fly a hanging load"


def _hybrid_for(env: Any, space: Any, hybrid: Hybrid | Mapping[str, Any], loop: Loop | None = None) -> Hybrid:
    """Return the hybrid, designed for the simulation of `env` and a loop if its base controller was given by name."""
    if space.shape not in ((OBSERVATION_SIZE,), (OUTPUT_FEEDBACK_SIZE,)):
        raise ValueError(
            f"a hybrid takes observations of {OBSERVATION_SIZE} or {OUTPUT_FEEDBACK_SIZE} numbers, not of {space}: put"
            " its wrapper inside the other wrappers that change the observation"
        )
    found, world = hybrid_from_data(hybrid) if isinstance(hybrid, Mapping) else hybrid, env.unwrapped.world
    if world.task.pendulum != "upright":
        raise ValueError(NO_HYBRID)
    return found.designed_for(world.simulation, loop) if isinstance(found.base_controller, str) else found


def _checked(action: Any, shape: tuple[int, ...]) -> Floats32:
    """Return the policy's action as float32; the environment sees only what the hybrid makes of it."""
    checked = clip_rounding(check_action(action, shape))
    if not (np.abs(checked) <= 1.0).all():
        raise ValueError(f"action must be four numbers in [-1, 1], not {checked.tolist()}")
    return checked


class HybridWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Put a hybrid around a single environment: the agent acts as its policy.

    Args:
        env: A QuadPendulum environment, wrapped or not, with or without velocities in the observation.
        hybrid: The hybrid, or its plain data. If its base controller was given by name, the base controller is
            designed for the nominal simulation of `env`.
    """

    def __init__(self, env: gym.Env[Any, Any], hybrid: Hybrid | Mapping[str, Any]) -> None:
        """Wrap `env`."""
        self.hybrid = _hybrid_for(env, env.observation_space, hybrid)
        named = isinstance(self.hybrid.base_controller, str)  # only a name can be in the environment's specification
        RecordConstructorArgs.__init__(self, hybrid=self.hybrid.as_data() if named else hybrid)
        gym.Wrapper.__init__(self, env)
        self.observation_space = observation_space(self.hybrid.observation_size(env.observation_space.shape[0]))  # type: ignore[index]
        self._memory: HybridMemory | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode and reset the base controller."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observe(observation, None), info

    def step(self, action: Any) -> tuple[Floats32, Any, bool, bool, dict[str, Any]]:
        """Apply the hybrid's action for the policy's `action`, shape (4,)."""
        if self._memory is None:
            raise ResetNeeded("reset must be called before step")
        applied, memory = self.hybrid.act(_checked(action, (ACTION_SIZE,))[np.newaxis], self._memory)
        observation, reward, terminated, truncated, info = self.env.step(applied[0])
        return self._observe(observation, memory), reward, terminated, truncated, info

    def _observe(self, observation: Floats32, memory: HybridMemory | None) -> Floats32:
        policy_observation, self._memory = self.hybrid.observe(
            observation[np.newaxis], memory, np.array([memory is None])
        )
        return np.asarray(policy_observation[0])


class VectorHybridWrapper(VectorWrapper):
    """`HybridWrapper` for a vector environment, in every autoreset mode.

    Args:
        env: A QuadPendulum vector environment, wrapped or not, with or without velocities in the observation.
        hybrid: The hybrid, or its plain data; as for `HybridWrapper`.
        loop: Delays and lags of `env` that the base controller knows, if it was given by name; None: there are none.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], hybrid: Hybrid | Mapping[str, Any], loop: Loop | None = None
    ) -> None:
        """Wrap `env`."""
        VectorWrapper.__init__(self, env)
        self.hybrid = _hybrid_for(env, env.single_observation_space, hybrid, loop)
        size = self.hybrid.observation_size(env.single_observation_space.shape[0])  # type: ignore[index]
        self.single_observation_space = observation_space(size)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._memory: HybridMemory | None = None
        self._asked: tuple[Floats32, HybridMemory] | None = None  # the base action, if it has been computed
        self._policy_observation = np.empty(0, np.float32)
        self._ended = np.zeros(self.num_envs, np.bool_)

    @property
    def base_action(self) -> Floats32:
        """Actions that the base controller would apply now, shape (num_envs, 4); zeros with `BandwidthScheduling`."""
        if self._memory is None:
            raise ResetNeeded("reset must be called before base_action")
        if self._asked is None:
            self._asked = self.hybrid.base_action(self._memory)
        return self._asked[0]

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode and reset the base controller in every sub-environment that is reset."""
        mask = (options or {}).get("reset_mask")  # before the reset, which may remove it from the options
        observation, info = self.env.reset(seed=seed, options=options)
        self._asked, started = None, np.ones(self.num_envs, np.bool_) if mask is None else mask
        if self._memory is None or mask is None:
            self._policy_observation, self._memory = self.hybrid.observe(observation, None, started)
        else:
            self._restart(started, observation)
        self._ended = self._ended & ~started
        return self._policy_observation.copy(), info

    def step(self, actions: Any) -> tuple[Floats32, Any, Any, Any, dict[str, Any]]:
        """Apply the hybrid's actions for the policy's `actions`, shape (num_envs, 4)."""
        if self._memory is None:
            raise ResetNeeded("reset must be called before step")
        memory = self._memory if self._asked is None else self._asked[1]
        applied, memory = self.hybrid.act(_checked(actions, (self.num_envs, ACTION_SIZE)), memory)
        self._asked = None
        observation, reward, terminated, truncated, info = self.env.step(applied)
        ended, next_step = terminated | truncated, self.metadata.get("autoreset_mode") is AutoresetMode.NEXT_STEP
        begun = self._ended if next_step else np.zeros(self.num_envs, np.bool_)
        self._policy_observation, self._memory = self.hybrid.observe(
            last_observations(observation, info, ended), memory, begun
        )
        if "final_obs" in info:
            replace_final_observations(info, ended, self._policy_observation)
            self._restart(ended, observation)
        self._ended = ended
        return self._policy_observation.copy(), reward, terminated, truncated, info

    def _restart(self, begun: Booleans, observation: Floats32) -> None:
        """Reset the base controller in the sub-environments whose episode begins."""
        rows = np.flatnonzero(begun)
        if not rows.size:
            return
        policy_observation, fresh = self.hybrid.observe(observation[rows], None, np.ones(rows.size, np.bool_))
        self._policy_observation[rows] = policy_observation
        self._memory = replace_rows(rows, fresh, self._memory)
