"""Companions as policies, with a learner that one can read."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines.hybrid.companion import Companion
from quadpend_baselines.policy.protocol import episode_start_mask
from quadpend_gym.core.arrays import Floats32

Learner = Callable[[Floats32], Floats32]


def idle(seen: Floats32) -> Floats32:
    """The learner that does nothing."""
    return np.zeros((len(seen), 4), np.float32)


def constant(*action: float) -> Learner:
    """The learner that always does the same."""
    return lambda seen: np.tile(np.float32(action), (len(seen), 1))


class Steered:
    """A companion and its learner as one policy with the `predict` protocol; it keeps what the learner saw."""

    def __init__(self, companion: Companion, learner: Learner = idle) -> None:
        self.companion, self.learner = companion, learner
        self.seen: list[Floats32] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        started = episode_start_mask(episode_start, state is None, len(observation))
        seen, memory = self.companion.watch(observation, state, started)
        self.seen.append(seen)
        return self.companion.act(self.learner(seen), memory)


def flown(policy: Any, env: VectorEnv[Any, Any, Any], steps: int, **reset: Any) -> tuple[list[Any], list[Any]]:
    """Actions and returns of the environment, of a flight through same-step autoresets; the policy is told of them."""
    observation, _ = env.reset(seed=5, **reset)
    memory, started = None, np.ones(env.num_envs, np.bool_)
    actions, returns = [], []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory, started)
        observation, reward, terminated, truncated, info = env.step(action)
        started = terminated | truncated
        actions.append(action)
        returns.append((observation, reward, terminated, truncated, info))
    return actions, returns
