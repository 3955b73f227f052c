"""Histories of observations and actions that belong to a policy, as those of `HistoryWrapper` to an environment."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import PolicyWrapper, episode_start_mask, select_rows
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE

OBSERVATION_SIZES = (OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE)
_MOST_ACTIONS = 8  # of a history that is found from its size


class History(NamedTuple):
    """What a network receives: the latest `observations` of `size` numbers each, then its latest `actions`."""

    size: int
    observations: int
    actions: int


def histories_of(inputs: int) -> list[History]:
    """Return the histories of up to 8 actions that have a number of inputs; there can be one of each observation."""
    return [
        History(size, (inputs - ACTION_SIZE * actions) // size, actions)
        for size in OBSERVATION_SIZES
        for actions in range(_MOST_ACTIONS + 1)
        if inputs - ACTION_SIZE * actions >= size and (inputs - ACTION_SIZE * actions) % size == 0
    ]


class _Memory(NamedTuple):
    policy: Any
    observations: Floats32  # oldest first, (n, k, m)
    actions: Floats32  # oldest first, (n, j, 4)


class HistoryPolicy(PolicyWrapper):
    """Give a policy the latest observations and actions, as `HistoryWrapper` does.

    Args:
        policy: A policy that observes the history.
        history: The history.
    """

    def __init__(self, policy: Policy, history: History) -> None:
        """Wrap `policy`."""
        super().__init__(policy)
        self.history, self.observation_sizes = history, (history.size,)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        rows = np.atleast_2d(np.asarray(observation, np.float32))
        started = episode_start_mask(episode_start, state is None, len(rows))
        memory = (
            np.repeat(rows[:, np.newaxis], self.history.observations, axis=1),
            np.zeros((len(rows), self.history.actions, ACTION_SIZE), np.float32),
        )
        if state is not None:
            memory = select_rows(started, memory, (pushed(state.observations, rows), state.actions))
        seen = np.concatenate([part.reshape(len(rows), -1) for part in memory], axis=1)
        action, inner = self.policy.predict(seen, state and state.policy, episode_start, deterministic)
        return action.reshape(*np.shape(observation)[:-1], ACTION_SIZE), _Memory(
            inner, memory[0], pushed(memory[1], action)
        )


def pushed(memory: Floats32, value: Floats32) -> Floats32:
    """Return `memory`, shape (n, k, m), without its oldest entry and with `value`, shape (n, m), as its latest."""
    return np.concatenate([memory[:, 1:], value[:, np.newaxis]], axis=1)[:, : memory.shape[1]]
