"""The vector environment: a world of many rows behind `gymnasium.vector.VectorEnv`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.core.validation import from_plain
from quadpend_gym.envs.outcome import REWARD, TERMINATED
from quadpend_gym.envs.recorder import Recorder, check_render_mode, warn_without_render_mode
from quadpend_gym.envs.reset_options import check_reset_options
from quadpend_gym.envs.spaces import action_space, check_action, check_options, observation_space
from quadpend_gym.envs.world import World
from quadpend_gym.physics.parameters import Simulation
from quadpend_gym.physics.state import State
from quadpend_gym.tasks import EPISODE_STEPS, as_task


class QuadPendulumVectorEnv(VectorEnv[Floats32, Floats32, Any]):
    """Many `QuadPendulumEnv` in one compiled loop.

    Row i, seeded with s, is exactly the single environment seeded with s, through every autoreset and for any number of
    rows. An integer seed s seeds row i with s + i.

    Args:
        num_envs: number of rows.
        task: as in `QuadPendulumEnv`.
        simulation: as in `QuadPendulumEnv`.
        wind: as in `QuadPendulumEnv`.
        max_episode_steps: control steps after which an episode is truncated; None: never.
        autoreset_mode: an `AutoresetMode` or its value, ``"NextStep"``, ``"SameStep"`` or ``"Disabled"``; only
            the latter keeps the specification JSON.
        render_mode: as in `QuadPendulumEnv`; ``"rgb_array"`` gives a tuple with an array for each row, ``"mosaic"``
            one array with the first 64 rows side by side, and ``"human"`` shows those.

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: an argument names or holds something unknown or out of range.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array", "mosaic"], "render_fps": 100}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        task: Any = "track",
        simulation: Any = None,
        wind: Any = None,
        max_episode_steps: int | None = EPISODE_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        """Build the environment; see the class for the arguments."""
        if not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs must be a whole number of at least 1, not {num_envs!r}")
        if max_episode_steps is not None and (not isinstance(max_episode_steps, int) or max_episode_steps < 1):
            raise ValueError(f"max_episode_steps must be a whole number of at least 1, not {max_episode_steps!r}")
        check_render_mode(render_mode, self.metadata["render_modes"])
        simulation = from_plain(Simulation, {} if simulation is None else simulation, "simulation")
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.render_mode = render_mode
        self.autoreset_mode = _as_autoreset_mode(autoreset_mode)
        fps = round(1.0 / simulation.period)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode, "render_fps": fps}
        self.world = World(num_envs, as_task(task), simulation, wind)
        self.recorder = None if render_mode is None else Recorder(self.world, render_mode)
        self.single_observation_space = observation_space()
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, np.bool_)
        self._seeded = np.zeros(num_envs, np.bool_)

    @property
    def state(self) -> State:
        """Named views of the rows' states, each of shape (num_envs, 3), see `quadpend_gym.physics.state`."""
        return State(self.world.state)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode in every row: the first of its seed, or the next one.

        Args:
            seed: an integer s for s, s + 1, …; a sequence with an integer, or None to go on, for each row; or None.
            options: ``state`` and ``reference`` as in `QuadPendulumEnv.reset`, for all rows or one for each;
                ``reset_mask``, shape (num_envs,), bool: reset these rows only.

        Raises:
            TypeError: an option is of the wrong type.
            ValueError: a seed is not a non-negative integer, or an option is unknown or has a wrong shape or value.
        """
        options = check_options(options, ("state", "reference", "reset_mask"))
        mask = self._check_mask(options.get("reset_mask"))
        rows = np.flatnonzero(mask)
        fixed = check_reset_options(options.get("state"), options.get("reference"), rows.size)
        self._seed(seed, mask)
        self.world.begin(rows, fixed)
        self._ended &= ~mask
        observation, outcome = self.world.look(np.arange(self.num_envs))
        if self.recorder is not None:
            self.recorder.begin(rows, outcome)
            self.recorder.show()
        return observation, self._info(outcome, mask)

    def step(self, actions: Any) -> tuple[Floats32, Floats, Booleans, Booleans, dict[str, Any]]:
        """Hold each row's action for one control period.

        Args:
            actions: shape (num_envs, 4), components in [−1, 1].

        Raises:
            ResetNeeded: a row has no running episode.
            TypeError: the actions are not made of numbers.
            ValueError: they have the wrong shape, or a row's is out of range or not finite.
        """
        actions = check_action(actions, (self.num_envs, 4))
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            raise ResetNeeded(
                f"the episode of row {self._ended.argmax()} is over: reset it with options={{'reset_mask': …}}"
            )
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and self._ended.any():
            actions = np.where(self._ended[:, np.newaxis], np.float32(0.0), actions)  # they only begin an episode
        observation, outcome = self.world.step(actions)
        reward = outcome[REWARD].copy()
        terminated = outcome[TERMINATED] != 0.0
        if self.recorder is not None:
            self.recorder.step(actions, outcome)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and self._ended.any():
            reward[self._ended], terminated[self._ended] = 0.0, False
            self._restart(np.flatnonzero(self._ended), observation, outcome)
        truncated = self._truncated()
        ended = terminated | truncated
        self._ended = ended.copy()
        final: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            rows = np.flatnonzero(ended)
            final_obs = np.empty(self.num_envs, object)  # of None
            for row, last in zip(rows, observation[rows], strict=True):
                final_obs[row] = last
            final_info = self._info(_only(outcome, rows), ended)
            final = {"final_obs": final_obs, "final_info": final_info, "_final_obs": ended, "_final_info": ended}
            self._restart(rows, observation, outcome)
        if self.recorder is not None:
            self.recorder.show()
        info = self._info(outcome, np.ones(self.num_envs, np.bool_))
        return observation, reward, terminated, truncated, {**info, **final}

    def render(self) -> Any:
        """The picture, see ``render_mode`` of the class; None where it is None or ``"human"``, which shows by itself.

        Raises:
            DependencyNotInstalled: there is no pygame-ce.
            ResetNeeded: a row was never reset.
        """
        if self.recorder is None:
            warn_without_render_mode(self)
            return None
        return self.recorder.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        if self.recorder is not None:
            self.recorder.close()

    def _truncated(self) -> Booleans:
        if self.recorder is not None and self.recorder.pop_end_request():
            return np.ones(self.num_envs, np.bool_)
        if self.max_episode_steps is None:
            return np.zeros(self.num_envs, np.bool_)
        return np.asarray(self.world.clock >= self.max_episode_steps)

    def _restart(self, rows: Integers, observation: Floats32, outcome: Floats) -> None:
        """Begin the next episode of some rows, and write what they look like."""
        self.world.begin(rows)
        observation[rows], outcome[:, rows] = self.world.look(rows)
        if self.recorder is not None:
            self.recorder.begin(rows, outcome)

    def _seed(self, seed: int | Sequence[int | None] | None, mask: Booleans) -> None:
        seeds = self._check_seeds(seed)
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        fresh = np.array([item is not None for item in seeds])
        unseeded = ~fresh & ~self._seeded
        drawn = iter(self.np_random.integers(2**63, size=unseeded.sum()).tolist() if unseeded.any() else [])
        chosen = [next(drawn) if missing else item for item, missing in zip(seeds, unseeded, strict=True)]
        rows = np.flatnonzero(mask & (fresh | unseeded))
        self.world.seed(rows, [int(chosen[row]) for row in rows])  # type: ignore[arg-type]
        self._seeded[rows] = True

    def _check_seeds(self, seed: Any) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer) and seed >= 0:
            return [int(seed) + row for row in range(self.num_envs)]
        if not isinstance(seed, Sequence | np.ndarray) or len(seed) != self.num_envs:
            raise ValueError(f"seed must be None, an integer of at least 0, or {self.num_envs} of these, not {seed!r}")
        for row, item in enumerate(seed):
            if item is not None and not (isinstance(item, int | np.integer) and item >= 0):
                raise ValueError(f"seed of row {row} must be None or an integer of at least 0, not {item!r}")
        return list(seed)

    def _check_mask(self, mask: Any) -> Booleans:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(f"options['reset_mask'] must be a boolean array of shape ({self.num_envs},), not {mask!r}")
        if not mask.any():
            raise ValueError("options['reset_mask'] must have a True in it")
        return mask.copy()

    def _info(self, outcome: Floats, mask: Booleans) -> dict[str, Any]:
        """`World.info` with Gymnasium's ``_key`` masks of the rows it is about."""
        info = self.world.info(outcome, outcome)
        terms = info["reward_terms"]
        info["reward_terms"] = {**terms, **{f"_{name}": mask for name in terms}}
        arrays = {name: value if name == "reward_terms" else value.T for name, value in info.items()}
        return {**arrays, **{f"_{name}": mask for name in arrays}}


def _only(array: Floats, rows: Integers) -> Floats:
    """A copy of some columns of an array, zero elsewhere."""
    out = np.zeros(array.shape)
    out[:, rows] = array[:, rows]
    return out


def _as_autoreset_mode(value: Any) -> AutoresetMode:
    try:
        return AutoresetMode(value)
    except ValueError as error:
        modes = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode must be an AutoresetMode or one of {modes}, not {value!r}") from error
