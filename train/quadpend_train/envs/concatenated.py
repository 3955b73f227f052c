"""Several vector environments as one, so that a learner can train in many scenarios at once."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from quadpend_gym.envs.spaces import action_space, meaning_of
from quadpend_gym.wrappers import last_observations, replace_final_observations


class ConcatenatedVectorEnv(VectorEnv[Any, Any, Any]):
    """The sub-environments of several vector environments, in the order of `envs`.

    The info has only ``tracking_error``, ``tilt``, ``cause`` and ``reward_terms``, without masks, beside the keys of
    same-step autoreset. The parts are QuadPendulum vector environments or concatenations of them, with same-step
    autoreset.
    """

    def __init__(self, envs: Sequence[VectorEnv[Any, Any, Any]]) -> None:
        self.envs = list(envs)
        first = envs[0]
        spaces = [env.single_observation_space for env in envs]
        if any(space != spaces[0] or meaning_of(space) != meaning_of(spaces[0]) for space in spaces):
            raise ValueError("envs must have the same observation space")
        if len({(world.simulation.interface, world.simulation.period) for env in envs for world in worlds(env)}) > 1:
            raise ValueError("envs must have the same interface and control period")
        self.metadata = dict(first.metadata)
        self.num_envs = sum(env.num_envs for env in envs)
        self.single_observation_space = first.single_observation_space
        self.single_action_space = first.single_action_space
        if len({world.simulation.vehicle.name for env in envs for world in worlds(env)}) > 1:
            self.single_action_space = action_space(**meaning_of(first.single_action_space) | {"vehicle": "any"})
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        edges = np.cumsum([0, *(env.num_envs for env in envs)])
        self._rows = [slice(*pair) for pair in pairwise(edges)]

    @property
    def world(self) -> Any:
        """The world of the first environment."""
        return worlds(self.envs[0])[0]

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every sub-environment; `seed` and `options` as in `QuadPendulumVectorEnv.reset`."""
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + row for row in range(self.num_envs)]
        mask, results = (options or {}).get("reset_mask"), []
        for env, rows in zip(self.envs, self._rows, strict=True):
            own = options if mask is None else {**(options or {}), "reset_mask": mask[rows]}
            results.append(env.reset(seed=None if seed is None else seed[rows], options=own))
        return np.concatenate([observation for observation, _ in results]), _concatenate([info for _, info in results])

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every sub-environment."""
        results = [env.step(actions[rows]) for env, rows in zip(self.envs, self._rows, strict=True)]
        *arrays, infos = zip(*results, strict=True)
        observation, reward, terminated, truncated = map(np.concatenate, arrays)
        info = _concatenate(infos)
        ended = terminated | truncated
        if ended.any():
            last = [last_observations(obs, part, fell | ran_out) for obs, _, fell, ran_out, part in results]
            replace_final_observations(info, ended, np.concatenate(last))
            # The rows of an environment in which no episode ended are masked, so its ordinary info fills them.
            final_infos = [part.get("final_info", part) for part in infos]
            info |= {"final_info": _concatenate(final_infos), "_final_info": ended}
        return observation, reward, terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close(**kwargs)


def worlds(env: VectorEnv[Any, Any, Any]) -> list[Any]:
    """Return the worlds under an environment: those of all parts of a `ConcatenatedVectorEnv`, or the only one."""
    unwrapped: Any = env.unwrapped
    if isinstance(unwrapped, ConcatenatedVectorEnv):
        return [world for part in unwrapped.envs for world in worlds(part)]
    return [unwrapped.world]


def _concatenate(infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
    terms = [info["reward_terms"] for info in infos]
    return {
        **{name: np.concatenate([info[name] for info in infos]) for name in ("tracking_error", "tilt", "cause")},
        "reward_terms": {name: np.concatenate([term[name] for term in terms]) for name in terms[0] if name[0] != "_"},
    }
