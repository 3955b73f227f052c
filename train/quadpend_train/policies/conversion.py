"""Objects of other libraries and functions as policies."""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.rotors import allocate_rotors
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_train.policies.history import History, HistoryPolicy
from quadpend_train.policies.normalization import Normalization

PROTOCOL = (
    "a policy is an object with predict(observation, state=None, episode_start=None, deterministic=True), which takes"
    " observations of shape (n, 36) and returns actions of shape (n, 4) in [-1, 1] and its memory"
)


def as_policy(value: Any) -> Policy:
    """Return an object as a policy.

    Args:
        value: A `quadpend_baselines.Policy`, which is returned; a model of Stable-Baselines3 or of a library with the
            same interface, see `quadpend_train.policies.export.policy_from_model`; or another object with `predict`,
            whose actions are thrust and torques, or those of the scenario.

    Raises:
        ValueError: If `value` is none of these, or a model has other observations or actions than the environment.
    """
    if isinstance(value, Policy):
        return value
    if "stable_baselines3" in sys.modules:  # a model needs it, other objects are converted without loading torch
        from stable_baselines3.common.base_class import BaseAlgorithm

        from quadpend_train.policies.export import policy_from_model

        if isinstance(value, BaseAlgorithm):
            return policy_from_model(value)
    if isinstance(value, type) or not callable(getattr(value, "predict", None)):
        raise ValueError(f"{value!r} is no policy: {PROTOCOL}")
    return ObjectPolicy(value)


class ObjectPolicy(Policy):
    """An object with the method `predict`; a class that derives from `Policy` can say more.

    Args:
        value: The object.
        normalization: Normalisation of what it observes; None: there is none.
    """

    def __init__(self, value: Any, normalization: Normalization | None = None) -> None:
        """Keep the object."""
        self.value, self.normalization = value, normalization

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return what the object returns; see `quadpend_baselines.Policy.predict`."""
        if self.normalization is not None:
            observation = self.normalization.apply(observation)
        returned = self.value.predict(observation, state, episode_start, deterministic=deterministic)
        if not isinstance(returned, tuple) or len(returned) != 2:
            raise ValueError(f"predict returned {type(returned).__name__}, not a tuple of actions and memory")
        return returned

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy; where the actions command rotors, its thrust and torques are allocated to them."""
        return allocate_rotors(self, scenario)


def policy_from_function(
    function: Callable[[Floats32], Any], size: int = 36, history: int = 1, history_actions: int = 0
) -> Policy:
    """Return a policy that calls a function, such as a torch module or a session of ONNX, for a batch of observations.

    Args:
        function: Maps observations, shape (n, m), float32, to actions, shape (n, 4), which are clipped to [−1, 1].
        size: Size of an observation: 36, or 27 without velocities.
        history: Number of the latest observations that the function receives, oldest first.
        history_actions: Number of the latest actions that it receives after them, oldest first.
    """
    return HistoryPolicy(FunctionPolicy(function), History(size, history, history_actions))


class FunctionPolicy(Policy):
    """A function of the observation, see `policy_from_function`."""

    def __init__(self, function: Callable[[Floats32], Any]) -> None:
        """Keep the function."""
        self.function = function

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and None; see `quadpend_baselines.Policy.predict`."""
        return np.clip(np.asarray(self.function(observation), np.float32), -1.0, 1.0), None
