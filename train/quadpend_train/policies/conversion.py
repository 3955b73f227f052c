"""Policies of other libraries and of the user's own code: objects with `predict`, functions, and factories.

A text ``"module:factory"`` names a function or class. It is called for each scenario: with its nominal `Simulation` if
its first argument is required or called ``simulation``, otherwise without arguments. It returns what `as_policy` takes,
or a pair of that and a wrapper: a function that maps the scenario's vector environment to the one in which the policy
flies, with a wall, an observed wind, or pixels.

Results of own policies are cached only if the factory has an attribute `fingerprint`, a text that its author changes
with the behaviour, because the cache cannot see whether the code has changed.
"""

import inspect
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from quadpend_baselines import Policy
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.policy.protocol import PolicyWrapper
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.factories import call_factory, find_factory
from quadpend_gym.envs.spaces import action_space
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import FULL, ObservationLayout, as_layout
from quadpend_train.policies.mlp_policy import check_interface
from quadpend_train.policies.normalization import Normalization

PROTOCOL = (
    "a policy is an object with predict(observation, state=None, episode_start=None, deterministic=True), which takes"
    " observations of shape (n, m) and returns actions of shape (n, 4) in [-1, 1] and its memory"
)


class ObjectPolicy(Policy):
    """An object with the method `predict`.

    Of a model, the normalisation may be known, and the fields, the interface and the vehicle of its training as in the
    card of an `MlpPolicy`.
    """

    def __init__(
        self, value: Any, normalization: Normalization | None = None, card: dict[str, Any] | None = None
    ) -> None:
        self.value, self.normalization, self.card = value, normalization, card
        self.layouts = (as_layout(card["observation"]),) if card and "observation" in card else _layouts(value)

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
        """Return the policy as it reads the observation of a scenario."""
        check_interface(self.card or {}, scenario.simulation)
        return fed_by_name(self, scenario)


def _layouts(value: Any) -> tuple[ObservationLayout, ...] | None:
    """Return what an object of the user says of its observations by its attribute ``layouts``, presets or lists."""
    given = getattr(value, "layouts", None)
    return None if given is None else tuple(map(as_layout, given))


class FunctionPolicy(Policy):
    """A policy that calls a function, such as a torch module or a session of ONNX, for a batch of observations.

    The function maps observations of the given fields, shape (n, m), float32, to actions, shape (n, 4), which are
    clipped to [−1, 1]. The fields are the name of a preset or a list.
    """

    def __init__(self, function: Callable[[Floats32], Any], fields: Any = FULL) -> None:
        self.function, self.layouts = function, (as_layout(fields),)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return the action and None; see `quadpend_baselines.Policy.predict`."""
        return np.clip(np.asarray(self.function(observation), np.float32), -1.0, 1.0), None

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy as it reads the observation of a scenario."""
        return fed_by_name(self, scenario)


def as_policy(value: Any) -> Policy:
    """Return a policy, a model (see `policy_from_model`), or another object with `predict` as a policy.

    The actions of another object are thrust and torques, or those of the scenario.
    """
    if isinstance(value, Policy):
        return value
    if "stable_baselines3" in sys.modules:  # a model needs it, other objects are converted without loading torch
        from stable_baselines3.common.base_class import BaseAlgorithm

        if isinstance(value, BaseAlgorithm):
            return policy_from_model(value)
    if isinstance(value, type) or not callable(getattr(value, "predict", None)):
        raise ValueError(f"{value!r} is no policy: {PROTOCOL}")
    return ObjectPolicy(value)


def policy_from_model(model: Any, vec_normalize: Any = None) -> Policy:
    """Return the policy of a model of any algorithm: by `export` if possible, else run by its `predict`.

    The memory of a recurrent model is the state of its LSTM.
    """
    from quadpend_train.policies.from_sb3 import export, normalization_of, trained_for

    normalization = normalization_of(model, vec_normalize)
    if model.action_space != action_space():
        raise ValueError(f"{type(model).__name__} acts in {model.action_space}; a policy acts in {action_space()}")
    card = trained_for(model)
    try:
        return export(model, vec_normalize)
    except Exception:  # networks of other libraries have other attributes
        return ObjectPolicy(model, normalization, card)


class FactoryPolicy(Policy):
    """A policy that a factory, named by a text ``"module:factory"``, makes anew for every scenario in `adapt`."""

    def __init__(self, name: str) -> None:
        self.name, self.factory = name, find_factory(name)
        text = getattr(self.factory, "fingerprint", None)
        self.fingerprint = f"{name} {text}" if isinstance(text, str) else None

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy that the factory makes for a scenario."""
        first = next(iter(inspect.signature(self.factory).parameters.values()), None)
        required = first is not None and first.default is first.empty and first.kind.name.startswith("POSITIONAL")
        takes = first is not None and (required or first.name == "simulation")
        made = call_factory(self.name, self.factory, *([scenario.simulation] if takes else []))
        policy, wrapper = made if isinstance(made, tuple) and len(made) == 2 else (made, None)
        as_it_is = wrapper is not None and not isinstance(policy, Policy)  # it reads what its wrapper observes
        try:
            adapted = (ObjectPolicy(policy) if as_it_is else as_policy(policy)).adapt(scenario)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from error
        return adapted if wrapper is None else _InWrapper(adapted, wrapper)


class _InWrapper(PolicyWrapper):
    """A policy with a wrapper around the environment."""

    def __init__(self, policy: Policy, wrapper: Callable[[Any], VectorEnv[Any, Any, Any]]) -> None:
        super().__init__(policy)
        self._wrapper = wrapper

    def wrap(self, env: VectorEnv[Any, Any, Any]) -> VectorEnv[Any, Any, Any]:
        """Return the environment in the wrapper."""
        return self._wrapper(self.policy.wrap(env))
