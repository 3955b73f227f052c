"""Reward relative to a controller in the very same episodes: a control variate that the seeds give away.

Every row has a twin with the same start, reference, wind and noise, which the controller flies alone. The learner is
rewarded with

    (1)  r − r_twin,

in which the luck that both have cancels, and what is left is what the learner's actions did. The twin begins anew
whenever the learner's episode ends. Falling must not pay where r < r_twin, so at a fall all that the twin is still to
earn is taken off at once, as if it earned from there on what it earns now:

    (2)  − r_twin γ (1 − γᵏ)/(1 − γ)       for the k steps that are left

What does not depend on the learner's actions leaves the best policy what it was.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from baselines import Policy
from quadpend_gym.arrays import Booleans, Floats
from quadpend_gym.kernel import REWARD, TERMINATED
from quadpend_gym.observation import OBSERVATION_SIZE
from train.mixture import worlds


class PairedReward(VectorWrapper):
    """Equations (1) and (2) around `env`.

    Args:
        env: a QuadPendulum vector environment or a `Mixture` of them with same-step autoreset, wrapped or not.
        twin: the same, made once more, without what belongs to the learner.
        controller: that flies the twin, from the whole observation.
        discount: γ, below 1.
        steps: of an episode.
        fall_cost: taken off at a fall besides (2).
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        twin: VectorEnv[Any, Any, Any],
        controller: Policy,
        discount: float,
        steps: int,
        fall_cost: float = 0.0,
    ) -> None:
        """Pair the rows."""
        VectorWrapper.__init__(self, env)
        edges = np.cumsum([0, *(world.rows for world in worlds(env))])
        self._parts = [
            (*worlds_of_both, slice(*edge))
            for *worlds_of_both, edge in zip(worlds(env), worlds(twin), pairwise(edges), strict=True)
        ]
        self._controller, self._discount, self._steps = controller, discount, steps
        self._fall_cost = fall_cost
        self._observation = np.empty((self.num_envs, OBSERVATION_SIZE), np.float32)
        self._memory: Any = None
        self._begun = np.ones(self.num_envs, np.bool_)
        self._fallen = np.zeros(self.num_envs, np.bool_)  # twins, whose learner flies on
        self._clock = np.zeros(self.num_envs, np.int64)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin in every row, and in its twin.

        Raises:
            ValueError: there are options, which twins do not know.
        """
        if options:
            raise ValueError(f"a paired environment takes no options, not {options!r}")
        observation, info = self.env.reset(seed=seed)
        self._follow(np.ones(self.num_envs, np.bool_))
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every row and its twin."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        earned = self._fly_twins()
        left = self._discount ** (self._steps - self._clock)
        lost = ~self._fallen * earned * self._discount * (1.0 - left) / (1.0 - self._discount)
        if (ended := terminated | truncated).any():
            self._follow(ended)
        return observation, reward - earned - terminated * (lost + self._fall_cost), terminated, truncated, info

    def _fly_twins(self) -> Floats:
        """What the twins earn with a step, shape (n,); nothing after a fall."""
        action, self._memory = self._controller.predict(self._observation, self._memory, self._begun)
        earned, fallen = np.zeros(self.num_envs), np.zeros(self.num_envs, np.bool_)
        for _, twin, rows in self._parts:
            self._observation[rows], outcome = twin.step(action[rows])
            earned[rows], fallen[rows] = outcome[REWARD], outcome[TERMINATED] != 0.0
        earned[self._fallen] = 0.0
        self._fallen |= fallen
        self._begun[:] = False
        self._clock += 1
        return earned

    def _follow(self, begun: Booleans) -> None:
        """Let twins begin the episodes that their learners have begun."""
        for learner, twin, part in self._parts:
            rows = np.flatnonzero(begun[part])
            if rows.size:
                twin.follow(learner, rows)
                self._observation[part][rows] = twin.look(rows)[0]
        self._begun |= begun
        self._fallen &= ~begun
        self._clock[begun] = 0
