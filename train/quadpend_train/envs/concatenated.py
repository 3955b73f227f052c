"""Several vector environments as one: a learner that trains in many scenarios at once."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from quadpend_gym.envs.spaces import check_action
from quadpend_gym.envs.vector_env import QuadPendulumVectorEnv
from quadpend_gym.wrappers.same_step import last_observations, replace_final_observations


class ConcatenatedVectorEnv(VectorEnv[Any, Any, Any]):
    """The rows of several environments with same-step autoreset, one environment's after the other's.

    Its info has ``tracking_error``, ``tilt`` and ``reward_terms`` only.

    Args:
        envs: with the same spaces and the same nominal simulation.

    Raises:
        ValueError: there are none, they reset differently, or have different spaces or simulations.
    """

    def __init__(self, envs: Sequence[VectorEnv[Any, Any, Any]]) -> None:
        """Put the environments together."""
        if not envs:
            raise ValueError("a mixture needs an environment")
        first = envs[0]
        for env in envs:
            if (mode := env.metadata.get("autoreset_mode")) is not AutoresetMode.SAME_STEP:
                raise ValueError(f"a mixture's environments must have autoreset_mode SAME_STEP, not {mode}")
            if not isinstance(env.unwrapped, QuadPendulumVectorEnv):
                raise ValueError(f"a mixture is made of QuadPendulum environments, not of {env}")
            if env.single_observation_space != first.single_observation_space:
                raise ValueError(
                    f"a mixture's environments must have the same observations, not {first.single_observation_space}"
                    f" and {env.single_observation_space}"
                )
            if _world(env).simulation != _world(first).simulation:
                raise ValueError("a mixture's environments must have the same nominal simulation")
        self.envs = list(envs)
        self.metadata = dict(first.metadata)
        self.num_envs = sum(env.num_envs for env in envs)
        self.single_observation_space = first.single_observation_space
        self.single_action_space = first.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        edges = np.cumsum([0, *(env.num_envs for env in envs)])
        self._rows = [slice(*pair) for pair in pairwise(edges)]

    @property
    def world(self) -> Any:
        """That of the first environment; all have the same nominal simulation."""
        return _world(self.envs[0])

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every row; `seed` as in `QuadPendulumVectorEnv.reset`."""
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + row for row in range(self.num_envs)]
        if seed is not None and (not hasattr(seed, "__len__") or len(seed) != self.num_envs):
            raise ValueError(f"seed must be None, an integer of at least 0, or {self.num_envs} of these, not {seed!r}")
        begun = [
            env.reset(seed=None if seed is None else seed[rows], options=options)
            for env, rows in zip(self.envs, self._rows, strict=True)
        ]
        return np.concatenate([observation for observation, _ in begun]), _merged([info for _, info in begun])

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every row."""
        actions = check_action(actions, (self.num_envs, 4))
        if not (np.abs(actions) <= 1.0).all():
            raise ValueError("action must be four numbers in [-1, 1] in every row")
        stepped = [env.step(actions[rows]) for env, rows in zip(self.envs, self._rows, strict=True)]
        observation, reward, terminated, truncated = (
            np.concatenate([result[part] for result in stepped]) for part in range(4)
        )
        info = _merged([result[4] for result in stepped])
        ended = terminated | truncated
        if ended.any():
            last = [last_observations(first, part, fell | ran_out) for first, _, fell, ran_out, part in stepped]
            replace_final_observations(info, ended, np.concatenate(last))
            finals = [part.get("final_info", part) for *_, part in stepped]  # where none ended, none is read
            info |= {"final_info": _merged(finals), "_final_info": ended}
        return observation, reward, terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Close all."""
        for env in self.envs:
            env.close(**kwargs)


def _world(env: VectorEnv[Any, Any, Any]) -> Any:
    unwrapped: Any = env.unwrapped
    assert isinstance(unwrapped, QuadPendulumVectorEnv)
    return unwrapped.world


def _merged(infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
    terms = [info["reward_terms"] for info in infos]
    return {
        **{name: np.concatenate([info[name] for info in infos]) for name in ("tracking_error", "tilt")},
        "reward_terms": {name: np.concatenate([term[name] for term in terms]) for name in terms[0]},
    }


def worlds(env: VectorEnv[Any, Any, Any]) -> list[Any]:
    """The worlds under an environment: one, or those of the parts of a `Mixture`."""
    inner: Any = env.unwrapped
    return [_world(part) for part in inner.envs] if isinstance(inner, ConcatenatedVectorEnv) else [_world(inner)]
