"""Histories of observations and actions that belong to a policy, as those of `HistoryWrapper` to an environment."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import PolicyWrapper, episode_start_mask, select_rows
from quadpend_gym.core.arrays import Floats32, Integers
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_SIZE
from quadpend_train.policies.finite_differences import with_velocities

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


class FunctionPolicy(Policy):
    """A function of the observation, see `quadpend_train.policies.conversion.policy_from_function`."""

    def __init__(self, function: Callable[[Floats32], Any]) -> None:
        self.function = function

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and None; see `quadpend_baselines.Policy.predict`."""
        return np.clip(np.asarray(self.function(observation), np.float32), -1.0, 1.0), None


class HistoryMemory(NamedTuple):
    """The memory of a `HistoryPolicy` for n rows."""

    observations: Floats32  # oldest first, (n, k, m)
    actions: Floats32  # oldest first, (n, j, 4)
    output: Floats32  # latest action, (n, 4)
    steps: Integers  # control steps since the start of the episode, (n,)
    policy: Any  # memory of the wrapped policy


class HistoryPolicy(PolicyWrapper):
    """Give a policy the latest observations and actions, as `HistoryWrapper` does, and repeat its actions."""

    def __init__(self, policy: Policy, history: History, action_repeat: int = 1) -> None:
        super().__init__(policy)
        self.history, self.action_repeat, self.observation_sizes = history, action_repeat, (history.size,)

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy, with velocities if it needs them."""
        return with_velocities(self, scenario)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        rows = np.atleast_2d(np.asarray(observation, np.float32))
        n, zeros = len(rows), np.zeros((len(rows), ACTION_SIZE), np.float32)
        observations = np.repeat(rows[:, np.newaxis], self.history.observations, axis=1)
        actions = np.repeat(zeros[:, np.newaxis], self.history.actions, axis=1)
        memory = HistoryMemory(observations, actions, zeros, np.zeros(n, np.int64), ())
        if state is not None:
            later = state._replace(observations=_pushed(state.observations, rows), policy=())
            memory = select_rows(episode_start_mask(episode_start, False, n), memory, later)
        seen = np.concatenate([memory.observations.reshape(n, -1), memory.actions.reshape(n, -1)], axis=1)
        action, inner = self.policy.predict(seen, state and state.policy, episode_start, deterministic)
        if self.action_repeat > 1:
            action = select_rows(memory.steps % self.action_repeat == 0, action, memory.output)
        after = HistoryMemory(memory.observations, _pushed(memory.actions, action), action, memory.steps + 1, inner)
        return action.reshape(*np.shape(observation)[:-1], ACTION_SIZE), after


def _pushed(memory: Floats32, value: Floats32) -> Floats32:
    """Return `memory`, shape (n, k, m), without its oldest entry and with `value`, shape (n, m), as its latest."""
    return np.concatenate([memory[:, 1:], value[:, np.newaxis]], axis=1)[:, : memory.shape[1]]
