"""Objects with the method `predict`, and functions, as policies."""

from collections.abc import Callable
from typing import Any

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.rotors import allocate_rotors
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_train.policies.normalization import Normalization

PROTOCOL = (
    "a policy is an object with predict(observation, state=None, episode_start=None, deterministic=True), which takes"
    " observations of shape (n, 36) and returns actions of shape (n, 4) in [-1, 1] and its memory"
)


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


class FunctionPolicy(Policy):
    """A function of the observation, see `quadpend_train.policies.conversion.policy_from_function`."""

    def __init__(self, function: Callable[[Floats32], Any]) -> None:
        """Keep the function."""
        self.function = function

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and None; see `quadpend_baselines.Policy.predict`."""
        return np.clip(np.asarray(self.function(observation), np.float32), -1.0, 1.0), None
