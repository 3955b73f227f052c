"""The one loop in which a policy flies: one episode in every row of a vector environment."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines.policy.protocol import Policy
from quadpend_gym.core.arrays import Booleans, Floats, Floats32


class RolloutStep(NamedTuple):
    """One control step of n rows; what stands in rows that do not fly any more means nothing.

    Attributes:
        active: rows whose first episode has this step, shape (n,).
        action: shape (n, 4).
        memory: of the policy, after it has chosen the action.
        reward: shape (n,).
        tracking_error: after the step, m, shape (n, 3).
        tilt: of the pendulum from upright, after the step, rad, shape (n,).
        terminated: shape (n,).
        truncated: shape (n,).
    """

    active: Booleans
    action: Floats32
    memory: Any
    reward: Floats
    tracking_error: Floats
    tilt: Floats
    terminated: Booleans
    truncated: Booleans

    @property
    def survived(self) -> Booleans:
        """Rows whose episode has lasted its time with this step, shape (n,)."""
        return self.active & self.truncated & ~self.terminated

    @property
    def continuing(self) -> Booleans:
        """Rows whose first episode has another step, shape (n,)."""
        return self.active & ~(self.truncated | self.terminated)


def rollout(
    policy: Policy, env: VectorEnv[Any, Any, Any], seed: int | list[int], options: dict[str, Any] | None = None
) -> Iterator[RolloutStep]:
    """Fly the first episode of every row, until none flies any more.

    Args:
        policy: anything that obeys the `predict` protocol; it flies deterministically.
        env: with same-step autoreset.
        seed: Seed of the first sub-environment, whose successors get consecutive seeds; or the seed of each one.
        options: of the reset.
    """
    observation, _ = env.reset(seed=seed, options=options)
    active, started, memory = np.ones(env.num_envs, np.bool_), np.ones(env.num_envs, np.bool_), None
    while active.any():
        action, memory = policy.predict(observation, memory, started, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        started = terminated | truncated
        error, tilt = info["tracking_error"].copy(), info["tilt"].copy()
        if started.any():  # these rows' info is of their next episode
            final = info["final_info"]
            error[started], tilt[started] = final["tracking_error"][started], final["tilt"][started]
        step = RolloutStep(active, action, memory, reward, error, tilt, terminated, truncated)
        yield step
        active = step.continuing
