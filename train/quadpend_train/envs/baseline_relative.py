"""Reward relative to a baseline controller in the same episodes: a control variate.

Each sub-environment has a *baseline copy*: an environment with the same start, reference, wind and noise, in which a
classical controller acts alone. The learner's reward is

    (1)  r − r_b,

where r is the reward of the learner's step and r_b that of the copy's step. Random influences on both cancel, so the
variance of (1) is smaller than that of r. The copy begins a new episode whenever the learner's episode ends.

A fall is an early termination. Where r < r_b, it would avoid the negative rewards (1) of the steps to come. Therefore
the reward of a fall is reduced by the discounted return that the copy would still earn, estimated as r_b at every
further step, and each fall has a penalty c:

    (2)  − r_b γ/(1 − γ) − c     when the learner falls,       + c     when the copy falls.

After a fall of the copy r_b = 0 until the learner's episode ends. If c = 0, and apart from the estimate in (2), a
policy is optimal for this reward if it is optimal for r. A positive c makes falls more expensive.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.envs.outcome import REWARD, TERMINATED
from quadpend_train.envs.concatenated import worlds


class BaselineRelativeReward(VectorWrapper):
    """Replace the reward of `env` by equations (1) and (2).

    The wrapper steps the worlds of `baseline_env` and not `baseline_env` itself, because a baseline copy starts an
    episode when the learner does, and does not reset after its own fall.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        baseline_env: VectorEnv[Any, Any, Any],
        controllers: Sequence[Policy],
        gamma: float,
        failure_penalty: float = 0.0,
    ) -> None:
        VectorWrapper.__init__(self, env)
        edges = np.cumsum([0, *(world.num_envs for world in worlds(env))])
        self._parts = [
            (*pair, controller, slice(*edge))
            for *pair, controller, edge in zip(
                worlds(env), worlds(baseline_env), controllers, pairwise(edges), strict=True
            )
        ]
        self._failure_penalty = failure_penalty
        self._horizon = gamma / (1.0 - gamma)
        baseline_world = worlds(baseline_env)[0]
        self._columns = baseline_world.observed.select(baseline_world.scenario.observation)
        self._observation = np.empty((self.num_envs, baseline_world.observed.size), np.float32)  # of the copies
        self._memories: list[Any] = [None] * len(self._parts)
        self._started = np.ones(self.num_envs, np.bool_)  # copies whose next step is the first of an episode
        self._fallen = np.zeros(self.num_envs, np.bool_)  # copies that fell while the learner's episode goes on

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every sub-environment, or in those of ``reset_mask``, and in its baseline copy."""
        mask = (options or {}).get("reset_mask")
        observation, info = self.env.reset(seed=seed, options=options)
        self._copy_episodes(np.ones(self.num_envs, np.bool_) if mask is None else mask)
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every sub-environment and its baseline copy."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        baseline_reward, baseline_fell = self._step_copies()
        relative = reward - baseline_reward + self._failure_penalty * baseline_fell
        relative -= terminated * (~self._fallen * baseline_reward * self._horizon + self._failure_penalty)
        if (ended := terminated | truncated).any():
            self._copy_episodes(ended)
        return observation, relative, terminated, truncated, info

    def _step_copies(self) -> tuple[Floats, Booleans]:
        """Return the copies' rewards, zero after a fall, and whether they fall at this step, shape (n,) each."""
        observed = self._observation[:, self._columns]
        reward, terminated = np.zeros(self.num_envs), np.zeros(self.num_envs, np.bool_)
        for number, (_, baseline_world, controller, rows) in enumerate(self._parts):
            action, self._memories[number] = controller.predict(
                observed[rows], self._memories[number], self._started[rows]
            )
            self._observation[rows], outcome = baseline_world.step(action)
            reward[rows], terminated[rows] = outcome[REWARD], outcome[TERMINATED] != 0.0
        reward[self._fallen] = 0.0
        fell = terminated & ~self._fallen
        self._fallen |= terminated
        self._started[:] = False
        return reward, fell

    def _copy_episodes(self, started: Booleans) -> None:
        """Copy the episodes that the learner has just begun, where `started`, into the baseline copies."""
        for world, baseline_world, _, part in self._parts:
            rows = np.flatnonzero(started[part])
            if rows.size:
                baseline_world.copy_episodes(world, rows)
                self._observation[part][rows] = baseline_world.observe(rows)[0]
        self._started |= started
        self._fallen &= ~started
