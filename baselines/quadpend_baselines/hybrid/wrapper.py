"""A wrapper that puts a hybrid around a vector environment, so that an agent learns or acts as its policy."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.hybrid.hybrids import Hybrid, HybridMemory, hybrid_from_data
from quadpend_baselines.policy.protocol import replace_rows
from quadpend_gym.core.arrays import Booleans, Floats32
from quadpend_gym.envs.inputs import check_action, clip_rounding
from quadpend_gym.envs.spaces import action_space, meaning_of, observation_space
from quadpend_gym.envs.world import world_of
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK, PRESETS, as_layout
from quadpend_gym.wrappers import last_observations, replace_final_observations

NO_HYBRID = "hybrids balance an upright pendulum: the base controller does not fly a hanging load"


class VectorHybridWrapper(VectorWrapper):
    """Put a hybrid around a vector environment, in every autoreset mode: the agent acts as its policy.

    Args:
        env: A QuadPendulum vector environment, wrapped or not, with or without velocities in the observation.
        hybrid: The hybrid, or its plain data. If its base controller was given by name, the base controller is
            designed for the nominal simulation of `env`.
        loop: Delays and lags of `env` that a base controller given by name knows; None: there are none.
        teaches: Whether the base controller of a `MemoryOnly` given by name flies along, so that `base_action` labels
            an imitation.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        hybrid: Hybrid | Mapping[str, Any],
        loop: Loop | None = None,
        teaches: bool = False,
    ):
        super().__init__(env)
        space, world = env.single_observation_space, world_of(env)
        meaning = meaning_of(space)
        layout = meaning.get("layout")
        if layout not in PRESETS.values() or "history" in meaning:
            raise ValueError(
                f"a hybrid takes the observation {' or '.join(map(repr, PRESETS))}, not {space}: put its wrapper inside"
                " the other wrappers that change the observation"
            )
        if world.task.pendulum != "upright":
            raise ValueError(NO_HYBRID)
        found = hybrid_from_data(hybrid) if isinstance(hybrid, Mapping) else hybrid
        if layout == LAB and found.reads == "measurements":
            raise ValueError(
                f"a hybrid {found.kind!r} reads errors: give the environment observation='output_feedback'"
            )
        if layout != LAB and found.reads == "lab":
            raise ValueError(f"a hybrid {found.kind!r} reads positions: give the environment observation='lab'")
        named = isinstance(found.base_controller, str)
        made = found.designed_for if teaches else found.flown_in
        loop = replace(loop or Loop(), observation=as_layout(layout))
        self.hybrid = made(world.simulation, loop) if named else found
        errors = OUTPUT_FEEDBACK if layout == LAB else as_layout(layout)
        self.single_observation_space = observation_space(self.hybrid.observation_size(errors.size))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.single_action_space = action_space(hybrid=type(self.hybrid).__name__)
        self.memory: HybridMemory | None = None
        self._asked: tuple[Floats32, HybridMemory] | None = None  # the base action, if it has been computed
        self._seen = np.empty(0, np.float32)
        self._ended = np.zeros(self.num_envs, np.bool_)

    @property
    def base_action(self) -> Floats32:
        """Actions that the base controller would apply now, shape (num_envs, 4)."""
        if self.memory is None:
            raise ResetNeeded("reset must be called before base_action")
        if self._asked is None:
            self._asked = self.hybrid.base_action(self.memory)
        return self._asked[0]

    @property
    def built_on(self) -> Floats32:
        """Actions on which the policy builds, shape (num_envs, 4), see `Hybrid.builds_on`."""
        if self.memory is None:
            raise ResetNeeded("reset must be called before built_on")
        return self.memory.base_action

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode and reset the base controller in every sub-environment that is reset."""
        mask = (options or {}).get("reset_mask")  # before the reset, which may remove it from the options
        observation, info = self.env.reset(seed=seed, options=options)
        self._asked, started = None, np.ones(self.num_envs, np.bool_) if mask is None else mask
        if self.memory is None or mask is None:
            self._seen, self.memory = self.hybrid.observe(observation, None, started)
        else:
            self._restart(started, observation)
        self._ended = self._ended & ~started
        return self._seen.copy(), info

    def step(self, actions: Any) -> tuple[Floats32, Any, Any, Any, dict[str, Any]]:
        """Apply the hybrid's actions for the policy's `actions`, shape (num_envs, 4)."""
        if self.memory is None:
            raise ResetNeeded("reset must be called before step")
        action = clip_rounding(check_action(actions, (self.num_envs, ACTION_SIZE)))
        if not (np.abs(action) <= 1.0).all():  # the environment sees only what the hybrid makes of it
            raise ValueError(f"actions must be numbers in [-1, 1], not {action.tolist()}")
        applied, memory = self.hybrid.act(action, self.memory if self._asked is None else self._asked[1])
        self._asked = None
        observation, reward, terminated, truncated, info = self.env.step(applied)
        ended, next_step = terminated | truncated, self.metadata.get("autoreset_mode") is AutoresetMode.NEXT_STEP
        begun = self._ended if next_step else np.zeros(self.num_envs, np.bool_)
        self._seen, self.memory = self.hybrid.observe(last_observations(observation, info, ended), memory, begun)
        if "final_obs" in info:
            replace_final_observations(info, ended, self._seen)
            self._restart(ended, observation)
        self._ended = ended
        return self._seen.copy(), reward, terminated, truncated, info

    def _restart(self, begun: Booleans, observation: Floats32) -> None:
        """Reset the base controller in the sub-environments whose episode begins."""
        rows = np.flatnonzero(begun)
        if rows.size:
            seen, fresh = self.hybrid.observe(observation[rows], None, np.ones(rows.size, np.bool_))
            self._seen[rows], self.memory = seen, replace_rows(rows, fresh, self.memory)
