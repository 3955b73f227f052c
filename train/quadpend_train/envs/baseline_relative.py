"""Reward relative to a controller in the very same episodes: a control variate that the seeds give away.

Every row has a twin with the same start, reference, wind and noise, which the controller flies alone. The learner is
rewarded with

    (1)  r − r_twin,

in which the luck that both have cancels, and what is left is what the learner's actions did. The twin begins anew
whenever the learner's episode ends. Falling must not pay where r < r_twin, so at a fall of the learner all that the
twin is still to earn is taken off at once, as if it flew on for ever and earned what it earns now; and falls have a
price c:

    (2)  − r_twin γ/(1 − γ) − c     at a fall of the learner,       + c     at a fall of the twin

(1) alone would leave the best policy what it was, but for the approximation in (2); c moves it towards caution.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Booleans, Floats
from quadpend_gym.envs.outcome import REWARD, TERMINATED
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS, OUTPUT_FEEDBACK_SIZE
from quadpend_train.envs.concatenated import worlds


class BaselineRelativeReward(VectorWrapper):
    """Equations (1) and (2) around `env`.

    Args:
        env: a QuadPendulum vector environment or a `Mixture` of them with same-step autoreset, wrapped or not.
        twin: the same, made once more, without what belongs to the learner.
        controller: that flies the twin.
        gamma: γ of a step, below 1.
        failure_penalty: c.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        twin: VectorEnv[Any, Any, Any],
        controller: Policy,
        gamma: float,
        failure_penalty: float = 0.0,
    ) -> None:
        """Pair the rows."""
        VectorWrapper.__init__(self, env)
        edges = np.cumsum([0, *(world.rows for world in worlds(env))])
        self._parts = [
            (*worlds_of_both, slice(*edge))
            for *worlds_of_both, edge in zip(worlds(env), worlds(twin), pairwise(edges), strict=True)
        ]
        self._controller, self._ahead, self._fall_cost = controller, gamma / (1.0 - gamma), failure_penalty
        hidden = twin.single_observation_space.shape == (OUTPUT_FEEDBACK_SIZE,)
        self._columns = OUTPUT_FEEDBACK_COLUMNS if hidden else np.arange(OBSERVATION_SIZE)
        self._observation = np.empty((self.num_envs, OBSERVATION_SIZE), np.float32)
        self._memory: Any = None
        self._begun = np.ones(self.num_envs, np.bool_)
        self._fallen = np.zeros(self.num_envs, np.bool_)  # twins, whose learner flies on

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
        earned, fell = self._fly_twins()
        paid = reward - earned + self._fall_cost * fell
        paid -= terminated * (~self._fallen * earned * self._ahead + self._fall_cost)
        if (ended := terminated | truncated).any():
            self._follow(ended)
        return observation, paid, terminated, truncated, info

    def _fly_twins(self) -> tuple[Floats, Booleans]:
        """What the twins earn with a step, nothing after a fall, and whether they fall with it, shape (n,)."""
        seen = self._observation[:, self._columns]
        action, self._memory = self._controller.predict(seen, self._memory, self._begun)
        earned, fallen = np.zeros(self.num_envs), np.zeros(self.num_envs, np.bool_)
        for _, twin, rows in self._parts:
            self._observation[rows], outcome = twin.step(action[rows])
            earned[rows], fallen[rows] = outcome[REWARD], outcome[TERMINATED] != 0.0
        earned[self._fallen] = 0.0
        fell = fallen & ~self._fallen
        self._fallen |= fallen
        self._begun[:] = False
        return earned, fell

    def _follow(self, begun: Booleans) -> None:
        """Let twins begin the episodes that their learners have begun."""
        for learner, twin, part in self._parts:
            rows = np.flatnonzero(begun[part])
            if rows.size:
                twin.follow(learner, rows)
                self._observation[part][rows] = twin.look(rows)[0]
        self._begun |= begun
        self._fallen &= ~begun
