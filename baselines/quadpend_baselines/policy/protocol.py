"""The base class of learned and classical policies, rows of their memories, and actions from commands."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import ObservationLayout


class Policy:
    """Base class of controllers and learned policies, with the `predict` protocol of Stable-Baselines3.

    A policy can be passed to SB3's `evaluate_policy`. A class needs `predict` only; everything else has a default.
    """

    # Fields of the observations that the policy can read, the preferred ones first; None: those of the scenario.
    layouts: tuple[ObservationLayout, ...] | None = None
    # A text that changes with the behaviour of the policy, for the cache of results; None: they are not cached. A copy
    # by `copy.copy` has none, since its owner may change it.
    fingerprint: str | None = None
    has_linear_model: bool = True  # False: `modelling.linear_loop` need not look for one

    def __copy__(self) -> "Policy":
        """Return a shallow copy without the fingerprint."""
        other = object.__new__(type(self))
        other.__dict__ |= {**self.__dict__, "fingerprint": None}
        return other

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action for one observation or for a batch of observations.

        Args:
            observation: Shape (m,) or (n, m), laid out as `Scenario.observation`, or as one of `layouts`.
            state: The memory that the previous call returned; None in the first call.
            episode_start: Mask of the rows whose episode has just begun, shape (n,). None means that no episode has
                just begun, except in the first call.
            deterministic: False allows a learned policy to sample its action.

        Returns:
            The action, shape (4,) or (n, 4), in [-1, 1], and the memory of the policy.
        """
        raise NotImplementedError(f"{type(self).__name__} has no predict: a factory is called by adapt(scenario)")

    def adapt(self, scenario: Scenario) -> "Policy":
        """Return the policy for a scenario: designed for its vehicle, its known delays, what it observes."""
        return self

    def wrap(self, env: VectorEnv[Any, Any, Any]) -> VectorEnv[Any, Any, Any]:
        """Return the environment in which the policy flies, `env` or a wrapper around it."""
        return env


class PolicyWrapper(Policy):
    """A policy that changes what another one observes or commands."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.layouts = policy.layouts
        self.has_linear_model = policy.has_linear_model

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory of the wrapped policy; see `Policy.predict`."""
        return self.policy.predict(self.observed(observation), state, episode_start, deterministic)

    def observed(self, observation: Any) -> Any:
        """Return what the wrapped policy observes, for one observation or for a batch."""
        return observation

    def wrap(self, env: VectorEnv[Any, Any, Any]) -> VectorEnv[Any, Any, Any]:
        """Return the environment of the wrapped policy."""
        return self.policy.wrap(env)


def episode_start_mask(episode_start: Any, first: bool, rows: int) -> Booleans:
    """Return the mask of the rows whose episode has just begun, shape (rows,).

    `episode_start` is the argument of `predict`; `first` is whether it is called without a memory.
    """
    return np.full(rows, first if first or episode_start is None else episode_start, np.bool_)


def select_rows(rows: Booleans, then: Any, otherwise: Any) -> Any:
    """Return `then` in the rows of a mask, shape (n,), and `otherwise` in the other rows.

    Both are arrays of n rows, or (named) tuples of such arrays, nested to any depth.
    """
    return _map(lambda a, b: np.where(rows.reshape(-1, *[1] * (a.ndim - 1)), a, b), then, otherwise)


def replace_rows(rows: Integers, part: Any, whole: Any) -> Any:
    """Return a copy of `whole` with `part` in the rows of the indices `rows`, shape (k,); structures as above."""

    def replaced(part: Any, whole: Any) -> Any:
        out = whole.copy()
        out[rows] = part
        return out

    return _map(replaced, part, whole)


def take_rows(rows: Integers, whole: Any) -> Any:
    """Return the rows of the indices `rows`, shape (k,), of `whole`; structures as above."""
    return _map(lambda array: array[rows], whole)


def concatenate_rows(parts: Sequence[Any]) -> Any:
    """Return the rows of several equal structures as one."""
    return _map(lambda *arrays: np.concatenate(arrays), *parts)


def _map(function: Any, one: Any, *others: Any) -> Any:
    if isinstance(one, np.ndarray):
        return function(one, *others)
    if one is None:
        return None
    parts = [_map(function, *items) for items in zip(one, *others, strict=True)]
    return type(one)(*parts) if hasattr(one, "_fields") else tuple(parts)


def to_action(command: Floats, simulation: Simulation, rigid: Floats | None = None) -> Floats32:
    """Return the actions for demanded thrust and torques, see `actions_for` of `quadpend_gym.physics.plants`."""
    return plant_of(simulation).actions_for(command, rigid)
