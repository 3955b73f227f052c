"""An adapter from Gymnasium's `VectorEnv` to Stable-Baselines3's `VecEnv`."""

import time
from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment with the interface of Stable-Baselines3.

    When an episode ends, the info of its sub-environment has the values of the last step and, in ``info["episode"]``,
    return, length and time, as from Stable-Baselines3's `Monitor`; at other steps the infos are empty.

    Args:
        env: A vector environment whose ``metadata["autoreset_mode"]`` is `AutoresetMode.SAME_STEP`.
        reward_scale: A factor on the rewards that the learner receives. Episode returns are not scaled.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], reward_scale: float = 1.0) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f'env must be made with autoreset_mode="SameStep" of gym.make_vec, not with {mode}')
        self.env = env
        self.reward_scale = reward_scale
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions = np.empty(0)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, np.int64)
        self._start_time = time.perf_counter()
        self._sums: dict[str, Any] = {}  # of each sub-environment, shape (num_envs,)
        self._steps = 0

    def reset(self) -> Any:
        """Reset every sub-environment with the seeds and options set by `seed` and `set_options`."""
        if len(self._options) != self.num_envs:
            raise ValueError(f"options must be one mapping or {self.num_envs} mappings, not {len(self._options)}")
        seeds: Any = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        groups: dict[int, list[int]] = {}  # rows with the same mapping, or without options
        for row, options in enumerate(self._options):
            groups.setdefault(id(options) if options else 0, []).append(row)
        for rows in groups.values():
            options = dict(self._options[rows[0]] or {})
            mask = np.zeros(self.num_envs, np.bool_)
            mask[rows] = True
            if len(groups) > 1:
                options["reset_mask"] = mask
            observation, info = self.env.reset(seed=seeds, options=options or None)
            for row in rows:
                self.reset_infos[row] = _info_of(row, info)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observation

    def restart(self, rows: Any) -> Any:
        """Start the next episode in the sub-environments of a mask, and return the observations of all."""
        observation, _ = self.env.reset(options={"reset_mask": rows})
        self._returns[rows], self._lengths[rows] = 0.0, 0
        return observation

    def step_async(self, actions: Any) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Step every sub-environment.

        Where an episode ended, the observation is the first of the next episode and the info has the values of the last
        step, ``terminal_observation``, ``TimeLimit.truncated`` and ``episode``; elsewhere the info is empty.
        """
        observation, reward, terminated, truncated, vector_info = self.env.step(self._actions)
        self._steps += 1
        terms = {name: value for name, value in vector_info.get("reward_terms", {}).items() if name[0] != "_"}
        if "tracking_error" in vector_info:  # only QuadPendulum environments have it
            terms["tracking_error"] = np.linalg.norm(vector_info["tracking_error"], axis=1)
        for name, values in terms.items():
            self._sums[name] = self._sums.get(name, 0.0) + values
        self._returns += reward
        self._lengths += 1
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        begun = {**vector_info}  # the first values of the next episodes, where there are any
        last, final_info = begun.pop("final_obs", None), begun.pop("final_info", {})
        for index in np.flatnonzero(ended):
            self.reset_infos[index] = _info_of(index, begun)
            infos[index] = {
                **_info_of(index, final_info),
                "terminal_observation": last[index],
                "TimeLimit.truncated": bool(truncated[index] and not terminated[index]),
                "episode": {
                    "r": float(self._returns[index]),
                    "l": int(self._lengths[index]),
                    "t": round(time.perf_counter() - self._start_time, 6),
                },
            }
        self._returns[ended], self._lengths[ended] = 0.0, 0
        return observation, (self.reward_scale * reward).astype(np.float32), ended, infos

    def take_means(self) -> dict[str, float]:
        """Return the means of the reward terms and of the tracking error (m), and reset them.

        The means are over all sub-environments and over the steps since the last call. At a step that ends an episode
        they include the first values of the next episode, because the info of the vector environment has these.
        """
        means = {name: float(total.mean()) / self._steps for name, total in self._sums.items()}
        self._sums, self._steps = {}, 0
        return means

    def get_images(self) -> Sequence[Any]:
        """Return a picture of each sub-environment; the render mode of `env` must be ``rgb_array``."""
        return self.env.render()  # type: ignore[return-value]

    def close(self) -> None:
        """Close the wrapped environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the vector environment's attribute, once for each of `indices`."""
        return [getattr(self.env, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set the vector environment's attribute, which has one value for all sub-environments."""
        self._check_all(indices, f"to set {attr_name}")
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call the vector environment's method once and return its result once for each sub-environment."""
        self._check_all(indices, f"to call {method_name}")
        return [getattr(self.env, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Return True for Stable-Baselines3's `Monitor`, because this class provides the same episode statistics."""
        return [wrapper_class is Monitor] * len(self._rows(indices))

    def _rows(self, indices: Any) -> Any:
        return np.arange(self.num_envs)[[*self._get_indices(indices)]]

    def _check_all(self, indices: Any, purpose: str) -> None:
        if {*self._rows(indices)} != {*range(self.num_envs)}:
            raise ValueError(f"indices must be None or all sub-environments {purpose}, not {indices}")


def _info_of(row: Any, info: dict[str, Any]) -> dict[str, Any]:
    """Return copies of the values of one row of the info of a vector environment, where its masks are true."""
    return {
        name: _info_of(row, value) if isinstance(value, dict) else copy(value[row])  # a view would keep the whole array
        for name, value in info.items()
        if name[0] != "_" and (f"_{name}" not in info or info[f"_{name}"][row])
    }
