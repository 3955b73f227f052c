"""Environments in which a classical controller flies along with the learner, see `companion`.

| wrapper                          | what it brings                                                   |
|----------------------------------|------------------------------------------------------------------|
| `DisturbanceEstimateObservation` | the learner acts alone, and observes the controller's estimates  |
| `ResidualAction`                 | the controller acts, and the learner corrects its actions        |
| `PaceAction`                     | the controller acts, and the learner sets its bandwidths         |

Each for a single environment and, as ``Vector…``, for a vector of them in every autoreset mode:

    env = ResidualAction(gym.make("quadpend_gym:QuadPendulum-v0", wind="windy"), "flatness", authority=0.3)
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from quadpend_baselines.controllers.registry import controller as by_name
from quadpend_baselines.hybrid.companion import Companion, CompanionMemory
from quadpend_gym.core.arrays import Booleans, Floats32
from quadpend_gym.envs.spaces import check_action, observation_space
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE

_SIZES = (OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE)


def _companion(env: Any, space: Any, controller: Any, steers: str, authority: float, caution: float) -> Companion:
    if getattr(space, "shape", None) not in {(size,) for size in _SIZES}:
        raise ValueError(
            f"a companion flies from an observation of {' or '.join(map(str, _SIZES))} numbers, not from {space}: put"
            " its wrapper inside those that change the observation otherwise"
        )
    if isinstance(controller, str):
        world = getattr(env.unwrapped, "world", None)
        controller = by_name(controller, None if world is None else world.simulation)
    return Companion(controller, steers, authority, caution)


def _checked(action: Any, shape: tuple[int, ...], memory: Any) -> Floats32:
    """The learner's action as the environment would take it; what acts in the end keeps to the limits anyway."""
    if memory is None:
        raise ResetNeeded("reset must be called before step")
    checked = check_action(action, shape)
    if not (np.abs(checked) <= 1.0).all():
        raise ValueError(f"action must be four numbers in [-1, 1], not {checked.tolist()}")
    return checked


class WithCompanion(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """What the wrappers of a single environment do."""

    def __init__(
        self, env: gym.Env[Any, Any], controller: Any, steers: str, authority: float, caution: float = 0.0
    ) -> None:
        gym.Wrapper.__init__(self, env)
        self.companion = _companion(env, env.observation_space, controller, steers, authority, caution)
        self.observation_space = observation_space(self.companion.size(env.observation_space.shape[0]))  # type: ignore[index]
        self._memory: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode, in which the controller knows nothing yet."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._watch(observation, None), info

    def step(self, action: Any) -> tuple[Floats32, Any, bool, bool, dict[str, Any]]:
        """Let the learner's action act, alone or on top of the controller's."""
        acting, memory = self.companion.act(_checked(action, (4,), self._memory)[np.newaxis], self._memory)
        observation, reward, terminated, truncated, info = self.env.step(acting[0])
        return self._watch(observation, memory), reward, terminated, truncated, info

    def _watch(self, observation: Floats32, memory: CompanionMemory | None) -> Floats32:
        seen, self._memory = self.companion.watch(observation[np.newaxis], memory, np.array([memory is None]))
        return np.asarray(seen[0])


class VectorWithCompanion(VectorWrapper):
    """What the wrappers of a vector environment do."""

    def __init__(
        self, env: VectorEnv[Any, Any, Any], controller: Any, steers: str, authority: float, caution: float = 0.0
    ) -> None:
        VectorWrapper.__init__(self, env)
        self.companion = _companion(env, env.single_observation_space, controller, steers, authority, caution)
        size = self.companion.size(env.single_observation_space.shape[0])  # type: ignore[index]
        self.single_observation_space = observation_space(size)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._memory: Any = None
        self._seen = np.empty(0, np.float32)
        self._ended = np.zeros(self.num_envs, np.bool_)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Floats32, dict[str, Any]]:
        """Begin an episode in every row that is reset, in which the controller knows nothing yet."""
        mask = (options or {}).get("reset_mask")  # which other vector environments take out of the options
        observation, info = self.env.reset(seed=seed, options=options)
        if mask is None or self._memory is None:
            self._seen, self._memory = self.companion.watch(observation, None, np.ones(self.num_envs, np.bool_))
        else:
            self._restart(mask, observation)
        self._ended = self._ended & ~(np.ones(self.num_envs, np.bool_) if mask is None else mask)
        return self._seen.copy(), info

    def step(self, actions: Any) -> tuple[Floats32, Any, Any, Any, dict[str, Any]]:
        """Let the learner's actions act, alone or on top of the controller's."""
        acting, memory = self.companion.act(_checked(actions, (self.num_envs, 4), self._memory), self._memory)
        observation, reward, terminated, truncated, info = self.env.step(acting)
        ended, last = terminated | truncated, observation
        if "final_obs" in info:  # same-step autoreset: the observation is of the next episode already
            last = observation.copy()
            last[ended] = np.stack(info["final_obs"][ended])
        begun = np.zeros(self.num_envs, np.bool_)
        if self.metadata.get("autoreset_mode") is AutoresetMode.NEXT_STEP:
            begun = self._ended
        self._seen, self._memory = self.companion.watch(last, memory, begun)
        if "final_obs" in info:
            for row in np.flatnonzero(ended):
                info["final_obs"][row] = self._seen[row].copy()
            self._restart(ended, observation)
        self._ended = ended
        return self._seen.copy(), reward, terminated, truncated, info

    def _restart(self, begun: Booleans, observation: Floats32) -> None:
        """Begin anew in some rows."""
        rows = np.flatnonzero(begun)
        seen, fresh = self.companion.watch(observation[rows], None, np.ones(rows.size, np.bool_))
        self._seen[rows] = seen
        self._memory = Companion.restarted(rows, fresh, self._memory)


class DisturbanceEstimateObservation(WithCompanion):
    """Observe, besides `env`'s observation, the disturbance that a controller's observer estimates.

    Of `Observed` controllers the whole observation is as their estimator sees it. See `companion` for the layout.

    Args:
        env: a QuadPendulum environment, wrapped or not, with or without velocities in the observation.
        controller: whose observer it is: one of `baselines.CONTROLLERS` by name, or a controller.

    Raises:
        TypeError: the controller estimates no disturbance.
        ValueError: there is no such controller, or `env` has another observation.
    """

    def __init__(self, env: gym.Env[Any, Any], controller: Any = "adrc-matched") -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, controller=controller)
        super().__init__(env, controller, "alone", 1.0)


class VectorDisturbanceEstimateObservation(VectorWithCompanion):
    """`DisturbanceEstimateObservation` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], controller: Any = "adrc-matched") -> None:
        """Wrap `env`."""
        super().__init__(env, controller, "alone", 1.0)


class ResidualAction(WithCompanion):
    """Let a controller fly `env`, and the agent add to its actions.

    The agent observes what the controller knows and what it is about to do; zero actions are the controller alone.

    Args:
        env: a QuadPendulum environment, wrapped or not, with or without velocities in the observation.
        controller: one of `baselines.CONTROLLERS` by name, or a controller.
        authority: factor on the agent's actions, in (0, 3].
        caution: how soon the agent is trusted less, γ of equation (4) of `companion`, in [0, 10]; 0: never.

    Raises:
        TypeError: the controller estimates no disturbance.
        ValueError: there is no such controller, `env` has another observation, or authority or caution is out of range.
    """

    def __init__(
        self, env: gym.Env[Any, Any], controller: Any = "flatness", authority: float = 0.3, caution: float = 0.0
    ) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, controller=controller, authority=authority, caution=caution)
        super().__init__(env, controller, "action", authority, caution)


class VectorResidualAction(VectorWithCompanion):
    """`ResidualAction` for a vector environment."""

    def __init__(
        self, env: VectorEnv[Any, Any, Any], controller: Any = "flatness", authority: float = 0.3, caution: float = 0.0
    ) -> None:
        """Wrap `env`."""
        super().__init__(env, controller, "action", authority, caution)


class PaceAction(WithCompanion):
    """Let a controller fly `env`, and the agent set how fast it is.

    The agent's four numbers are for the bandwidths of position, pendulum, attitude, and of height and yaw: a multiplies
    one by (1 + authority)^a. Zero actions are the controller as it is.

    Args:
        env: a QuadPendulum environment, wrapped or not, with or without velocities in the observation.
        controller: ``"flatness"``, or such a controller with gains of its own.
        authority: how far the bandwidths can be moved, in (0, 3].
        caution: how soon the agent is trusted less, γ of equation (4) of `companion`, in [0, 10]; 0: never.

    Raises:
        TypeError: the controller has no pace.
        ValueError: there is no such controller, `env` has another observation, or authority or caution is out of range.
    """

    def __init__(
        self, env: gym.Env[Any, Any], controller: Any = "flatness", authority: float = 1.0, caution: float = 0.0
    ) -> None:
        """Wrap `env`."""
        RecordConstructorArgs.__init__(self, controller=controller, authority=authority, caution=caution)
        super().__init__(env, controller, "pace", authority, caution)


class VectorPaceAction(VectorWithCompanion):
    """`PaceAction` for a vector environment."""

    def __init__(
        self, env: VectorEnv[Any, Any, Any], controller: Any = "flatness", authority: float = 1.0, caution: float = 0.0
    ) -> None:
        """Wrap `env`."""
        super().__init__(env, controller, "pace", authority, caution)
