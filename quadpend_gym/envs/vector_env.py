"""The vector environment: a `World` of many sub-environments behind the interface of `gymnasium.vector.VectorEnv`."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.core.settings import plain
from quadpend_gym.envs.env import frames_per_second
from quadpend_gym.envs.inputs import check_action
from quadpend_gym.envs.outcome import REWARD, TERMINATED
from quadpend_gym.envs.recorder import Recorder, check_render_mode, warn_without_render_mode
from quadpend_gym.envs.reset_options import NAMES, read_reset_options
from quadpend_gym.envs.spaces import spaces_of
from quadpend_gym.envs.world import World
from quadpend_gym.physics.state import ACTION_SIZE, State
from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.vehicles import CONTROL_PERIOD

_METADATA = {"render_modes": ["rgb_array"], "render_fps": round(1.0 / CONTROL_PERIOD)}


class QuadPendulumVectorEnv(VectorEnv[Floats32, Floats32, Any]):
    """Many `QuadPendulumEnv`s that one compiled loop steps together.

    A sub-environment with seed s returns exactly the same numbers as a `QuadPendulumEnv` with seed s, across autoresets
    too and for any number of sub-environments. An integer seed s gives sub-environment i the seed s + i.

    Args:
        num_envs: Number of sub-environments.
        scenario: As in `QuadPendulumEnv`.
        max_episode_steps: Control steps after which an episode is truncated; None: the duration of the scenario;
            −1: never.
        autoreset_mode: An `AutoresetMode` or its value: ``"NextStep"``, ``"SameStep"`` or ``"Disabled"``. Only with
            the value, which is a string, can the specification be converted to JSON.
        render_mode: With ``"rgb_array"`` the method `render` returns a tuple of one array for each sub-environment, as
            in `QuadPendulumEnv`.
        num_threads: Threads that advance the sub-environments, for some thousands of them or more. The numbers are the
            same for any number of threads.
        parts: Fields of the scenario, as in `QuadPendulumEnv`.
    """

    metadata: dict[str, Any] = _METADATA

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Any = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        num_threads: int = 1,
        **parts: Any,
    ) -> None:
        """Build the environment; the class documents the arguments."""
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.scenario = as_scenario(scenario, **parts)
        self.num_envs = num_envs = _whole_number("num_envs", num_envs)
        self.num_threads = _whole_number("num_threads", num_threads)
        self.max_episode_steps: float = self.scenario.steps
        if max_episode_steps is not None:
            no_limit = plain(max_episode_steps) == -1
            more = ", or -1 for no limit"
            self.max_episode_steps = (
                math.inf if no_limit else _whole_number("max_episode_steps", max_episode_steps, more)
            )
        self.render_mode = render_mode
        self.autoreset_mode = _as_autoreset_mode(autoreset_mode)
        fps = frames_per_second(self.scenario)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode, "render_fps": fps}
        self.world = World(num_envs, self.scenario, self.num_threads)
        self.recorder = None if render_mode is None else Recorder(self.world, render_mode)
        self.single_observation_space, self.single_action_space = spaces_of(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._columns = self.world.observed.select(self.scenario.observation)
        self._ended = np.zeros(num_envs, np.bool_)
        self._seeded = np.zeros(num_envs, np.bool_)

    @property
    def state(self) -> State:
        """Named views of the true states, each of shape (num_envs, 3), see `quadpend_gym.physics.state`."""
        return State(self.world.state)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Start an episode in every sub-environment: the first episode of its seed, or without a seed the next one.

        Args:
            seed: An integer s for the seeds s, s + 1, …; a sequence with one integer or None for each sub-environment;
                or None.
            options: ``state``, ``reference`` and ``parameters`` as in `QuadPendulumEnv`, one value for all
                sub-environments that are reset or one for each; ``reset_mask``, shape (num_envs,), bool: which
                sub-environments are reset, by default all.

        Returns:
            The observations of all sub-environments, shape (num_envs, m), and the info.
        """
        mask = self._mask((options or {}).get("reset_mask"))
        rows = np.flatnonzero(mask)
        checked = read_reset_options(options, (*NAMES, "reset_mask"), rows.size, self.scenario)
        self._seed(seed, mask)
        self.world.start_episodes(rows, checked)
        self._ended &= ~mask
        observation, outcome = self.world.observe(np.arange(self.num_envs))
        if self.recorder is not None:
            self.recorder.start_episodes(rows, outcome)
        return observation[:, self._columns], self._info(outcome, mask)

    def step(self, actions: Any) -> tuple[Floats32, Floats, Booleans, Booleans, dict[str, Any]]:
        """Apply one action in each sub-environment for one control period.

        Args:
            actions: Shape (num_envs, 4), components in [−1, 1].

        Returns:
            Observation, reward, terminated, truncated and info. With same-step autoreset, a step that ends episodes
            returns the first observation of the next ones, and the info has the last ones in ``final_obs`` and
            ``final_info``.

        Raises:
            ResetNeeded: If a sub-environment has no running episode.
        """
        actions = check_action(actions, (self.num_envs, ACTION_SIZE))
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            i = self._ended.argmax()
            raise ResetNeeded(f"the episode of sub-environment {i} is over: reset it with options={{'reset_mask': …}}")
        restarts = self.autoreset_mode is AutoresetMode.NEXT_STEP and bool(self._ended.any())
        if restarts:  # actions are ignored where the step only starts the next episode
            actions = np.where(self._ended[:, np.newaxis], np.float32(0.0), actions)
        observation, outcome = self.world.step(actions)
        reward = outcome[REWARD].copy()
        terminated = outcome[TERMINATED] != 0.0
        if self.recorder is not None:
            self.recorder.record_step(outcome)
        if restarts:
            reward[self._ended], terminated[self._ended] = 0.0, False
            self._restart(np.flatnonzero(self._ended), observation, outcome)
        truncated = np.asarray(self.world.clock >= self.max_episode_steps)
        ended = terminated | truncated
        self._ended = ended.copy()
        final: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            rows = np.flatnonzero(ended)
            final_obs = np.empty(self.num_envs, object)  # filled with None
            for row, last in zip(rows, observation[rows], strict=True):
                final_obs[row] = last[self._columns]
            final_outcome = np.zeros(outcome.shape)
            final_outcome[:, rows] = outcome[:, rows]
            final_info = self._info(final_outcome, ended)
            final = {"final_obs": final_obs, "final_info": final_info, "_final_obs": ended, "_final_info": ended}
            self._restart(rows, observation, outcome)
        info = self._info(outcome, np.ones(self.num_envs, np.bool_))
        return observation[:, self._columns], reward, terminated, truncated, {**info, **final}

    def render(self) -> Any:
        """Return a tuple of arrays of shape (480, 640, 3), uint8, with the render mode ``"rgb_array"``; else None."""
        if self.recorder is None:
            warn_without_render_mode(self)
            return None
        return self.recorder.render()

    def close_extras(self, **kwargs: Any) -> None:
        """End the processes of an autopilot, if there is one."""
        self.world.close()

    def _restart(self, rows: Integers, observation: Floats32, outcome: Floats) -> None:
        """Start the next episode of some sub-environments and overwrite their observations and outcomes."""
        self.world.start_episodes(rows)
        observation[rows], outcome[:, rows] = self.world.observe(rows)
        if self.recorder is not None:
            self.recorder.start_episodes(rows, outcome)

    def _seed(self, seed: int | Sequence[int | None] | None, mask: Booleans) -> None:
        """Seed the sub-environments of `mask` for which `seed` has a seed; draw seeds for those that never had one."""
        seeds = self._seeds(seed)
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        given = np.array([item is not None for item in seeds])
        unseeded = ~given & ~self._seeded
        drawn = iter(self.np_random.integers(2**63, size=unseeded.sum()).tolist() if unseeded.any() else [])
        chosen = [next(drawn) if missing else item for item, missing in zip(seeds, unseeded, strict=True)]
        rows = np.flatnonzero(mask & (given | unseeded))
        self.world.seed(rows, [int(chosen[row]) for row in rows])
        self._seeded[rows] = True

    def _seeds(self, seed: Any) -> list[Any]:
        if seed is None:
            return [None] * self.num_envs
        numbers = int | np.integer
        seeds = list(range(seed, seed + self.num_envs)) if isinstance(seed, numbers) else list(np.atleast_1d(seed))
        wrong = [item for item in seeds if item is not None and not (isinstance(item, numbers) and item >= 0)]
        if len(seeds) != self.num_envs or wrong:
            raise ValueError(f"seed must be None, an integer of at least 0, or {self.num_envs} of these, not {seed!r}")
        return seeds

    def _mask(self, mask: Any) -> Booleans:
        found = np.array(np.ones(self.num_envs, np.bool_) if mask is None else mask)
        if found.dtype != np.bool_ or found.shape != (self.num_envs,) or not found.any():
            raise ValueError(
                f"options['reset_mask'] must be a boolean array of shape ({self.num_envs},) with a True, not {mask!r}"
            )
        return found

    def _info(self, outcome: Floats, mask: Booleans) -> dict[str, Any]:
        """Return the info with Gymnasium's masks: ``_key`` is true where ``key`` holds a value."""
        info = self.world.step_info.read(outcome, outcome)
        terms = info["reward_terms"]
        info["reward_terms"] = {**terms, **{f"_{name}": mask for name in terms}}
        arrays = {name: value if name == "reward_terms" else value.T for name, value in info.items()}
        return {**arrays, **{f"_{name}": mask for name in arrays}}


def _whole_number(name: str, value: Any, more: str = "") -> int:
    """Return a positive integer, of Python or NumPy, as one of Python; `more` is accepted, for the error message."""
    number = plain(value)
    if type(number) is not int or number < 1:
        raise ValueError(f"{name} must be a whole number of at least 1{more}, not {value!r}")
    return number


def _as_autoreset_mode(value: Any) -> AutoresetMode:
    try:
        return AutoresetMode(value)
    except ValueError as error:
        modes = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode must be an AutoresetMode or one of {modes}, not {value!r}") from error
