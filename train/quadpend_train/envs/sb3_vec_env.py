"""Any Gymnasium `VectorEnv` with same-step autoreset as a Stable-Baselines3 `VecEnv`.

Stable-Baselines3 has its own vector interface; this adapter costs no Python per row except where an episode ended.
"""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv


class SB3VecEnv(VecEnv):
    """`env` as Stable-Baselines3 wants it, with episode statistics as its `Monitor` would give them.

    Args:
        env: a vector environment whose `metadata["autoreset_mode"]` is `AutoresetMode.SAME_STEP`.
        reward_scale: factor on the rewards that the learner sees; episode statistics keep the true ones.

    Raises:
        ValueError: it resets differently.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], reward_scale: float = 1.0) -> None:
        """Wrap `env`."""
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"env must have autoreset_mode {AutoresetMode.SAME_STEP}, not {mode}")
        self.env = env
        self.reward_scale = reward_scale
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions = np.empty(0)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, np.int64)
        self._began = time.perf_counter()
        self._sums: dict[str, float] = {}
        self._steps = 0

    def reset(self) -> Any:
        """Reset every row, with the seeds and options set by `seed` and `set_options`."""
        seeds = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        if any(options != self._options[0] for options in self._options):
            raise ValueError("options must be the same for every row")
        observation, _ = self.env.reset(seed=seeds, options=self._options[0] or None)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observation

    def step_async(self, actions: Any) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Step every row; rows that end come back with their next episode's first observation."""
        observation, reward, terminated, truncated, vector_info = self.env.step(self._actions)
        self._count(vector_info)
        self._returns += reward
        self._lengths += 1
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(ended):
            infos[row] = {
                "terminal_observation": vector_info["final_obs"][row],
                "TimeLimit.truncated": bool(truncated[row] and not terminated[row]),
                "episode": {
                    "r": float(self._returns[row]),
                    "l": int(self._lengths[row]),
                    "t": round(time.perf_counter() - self._began, 6),
                },
            }
        self._returns[ended] = 0.0
        self._lengths[ended] = 0
        return observation, (self.reward_scale * reward).astype(np.float32), ended, infos

    def _count(self, vector_info: dict[str, Any]) -> None:
        self._steps += 1
        if "tracking_error" in vector_info:  # not of other environments
            error = np.linalg.norm(vector_info["tracking_error"], axis=1).mean()
            self._sums["tracking_error"] = self._sums.get("tracking_error", 0.0) + error
        for name, value in vector_info.get("reward_terms", {}).items():
            if not name.startswith("_"):
                self._sums[name] = self._sums.get(name, 0.0) + value.mean()

    def take_means(self) -> dict[str, float]:
        """Means of the reward's terms, and of the tracking error (m), over all rows and the steps since the last call.

        At a step that ends an episode they are of the next one's beginning.
        """
        means = {name: float(total) / self._steps for name, total in self._sums.items()}
        self._sums, self._steps = {}, 0
        return means

    def get_images(self) -> Sequence[Any]:
        """A picture of each row, of which `render` makes one; of environments with the render mode ``rgb_array``."""
        return self.env.render()  # type: ignore[return-value]

    def close(self) -> None:
        """Close the wrapped environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The vector environment's attribute, once for each row asked for."""
        return [getattr(self.env, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set the vector environment's attribute; it has no attributes of single rows."""
        if len(self._rows(indices)) != self.num_envs:
            raise ValueError(f"{attr_name} can only be set for all rows at once")
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call the vector environment's method once; its result, once for each row asked for."""
        return [getattr(self.env, method_name)(*args, **kwargs)] * len(self._rows(indices))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Whether a wrapper of this class is around the vector environment; episodes are monitored here."""
        layer: Any = self.env
        found = wrapper_class.__name__ == "Monitor"
        while not found and layer is not None:
            found = isinstance(layer, wrapper_class)
            layer = getattr(layer, "env", None)
        return [found] * len(self._rows(indices))

    def _rows(self, indices: Any) -> Sequence[int]:
        return list(self._get_indices(indices))
