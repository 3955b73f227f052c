"""Objects of other libraries and functions as policies."""

import sys
from collections.abc import Callable
from typing import Any

from quadpend_baselines import Policy
from quadpend_gym.core.arrays import Floats32
from quadpend_train.policies.history import History, HistoryPolicy
from quadpend_train.policies.objects import PROTOCOL, FunctionPolicy, ObjectPolicy


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
