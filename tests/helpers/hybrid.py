"""Hybrids as policies, with simple agents as their learned part."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines.hybrid import Hybrid
from quadpend_baselines.policy.protocol import episode_start_mask
from quadpend_gym.core.arrays import Floats32

Agent = Callable[[Floats32], Floats32]


def zero_action(seen: Floats32) -> Floats32:
    """The agent that always outputs zero."""
    return np.zeros((len(seen), 4), np.float32)


def constant(*action: float) -> Agent:
    """An agent that always outputs `action`."""
    return lambda seen: np.tile(np.float32(action), (len(seen), 1))


class HybridPolicy:
    """A hybrid and its agent as one policy with the `predict` protocol; it records the agent's observations."""

    def __init__(self, hybrid: Hybrid, agent: Agent = zero_action) -> None:
        self.hybrid, self.agent = hybrid, agent
        self.seen: list[Floats32] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        started = episode_start_mask(episode_start, state is None, len(observation))
        seen, memory = self.hybrid.observe(observation, state, started)
        self.seen.append(seen)
        return self.hybrid.act(self.agent(seen), memory)


def run_policy(policy: Any, env: VectorEnv[Any, Any, Any], steps: int, **reset: Any) -> tuple[list[Any], list[Any]]:
    """Actions of a policy and the results of `env.step`, across same-step autoresets that the policy is told about."""
    observation, _ = env.reset(seed=5, **reset)
    memory, started = None, np.ones(env.num_envs, np.bool_)
    actions, results = [], []
    for _ in range(steps):
        action, memory = policy.predict(observation, memory, started)
        observation, reward, terminated, truncated, info = env.step(action)
        started = terminated | truncated
        actions.append(action)
        results.append((observation, reward, terminated, truncated, info))
    return actions, results
