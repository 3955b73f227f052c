"""The rollout of a policy: one episode in every sub-environment of a vector environment."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines.policy.protocol import Policy
from quadpend_gym.core.arrays import Booleans, Floats, Floats32


class RolloutStep(NamedTuple):
    """One control step of n sub-environments; values of inactive sub-environments have no meaning."""

    active: Booleans  # sub-environments whose first episode includes this step, shape (n,)
    action: Floats32  # shape (n, 4)
    reward: Floats  # shape (n,)
    tracking_error: Floats  # after the step, m, shape (n, 3)
    tilt: Floats  # angle of the pendulum from its side after the step, rad, shape (n,)
    cause: Floats  # of an early end with this step, a place in `CAUSES`, else 0, shape (n,)
    terminated: Booleans  # shape (n,)
    truncated: Booleans  # shape (n,)

    @property
    def survived(self) -> Booleans:
        """Sub-environments whose first episode reaches its time limit with this step, shape (n,)."""
        return self.active & self.truncated & ~self.terminated


def rollout(
    policy: Policy, env: VectorEnv[Any, Any, Any], seed: int | list[int], options: dict[str, Any] | None = None
) -> Iterator[RolloutStep]:
    """Run the first episode of every sub-environment and yield its steps, until all have ended.

    `env` has same-step autoreset. `seed` is that of the first sub-environment, whose successors get consecutive seeds,
    or that of each one.
    """
    observation, _ = env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # Gymnasium also accepts a list
    active, started, memory = np.ones(env.num_envs, np.bool_), np.ones(env.num_envs, np.bool_), None
    while active.any():
        action, memory = policy.predict(observation, memory, started, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        started = terminated | truncated
        measured = {name: info[name].copy() for name in ("tracking_error", "tilt", "cause")}
        if started.any():  # after a same-step autoreset, `info` describes the next episode
            for name, values in measured.items():
                values[started] = info["final_info"][name][started]
        yield RolloutStep(active, action, reward, **measured, terminated=terminated, truncated=truncated)
        active = active & ~started
