"""Policies of the user's own code, named by a text ``"module:factory"``.

A factory is a function or class. It is called for each scenario: with its nominal `Simulation` if its first argument is
required or called ``simulation``, otherwise without arguments. It returns what
`quadpend_train.policies.conversion.as_policy` takes, or a pair of that and a wrapper: a function that maps the
scenario's vector environment to the one in which the policy flies, with a wall, an observed wind, or pixels.

Results of own policies are cached only if the factory has an attribute `fingerprint`, a text that its author changes
with the behaviour, because the cache cannot see whether the code has changed.
"""

import inspect
from collections.abc import Callable
from functools import cached_property
from typing import Any

from gymnasium.vector import VectorEnv

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import PolicyWrapper
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.factories import call_factory, find_factory
from quadpend_gym.scenarios import Scenario
from quadpend_train.policies.conversion import as_policy


class FactoryPolicy(Policy):
    """A policy that a factory makes anew for every scenario; without `adapt`, for the default one.

    Args:
        name: The text ``"module:factory"``.
    """

    def __init__(self, name: str) -> None:
        """Find the factory, without calling it."""
        self.name, self.factory = name, find_factory(name)
        text = getattr(self.factory, "fingerprint", None)
        self.fingerprint = f"{name} {text}" if isinstance(text, str) else None

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the policy that the factory makes for a scenario.

        Raises:
            ValueError: If the factory fails or returns no policy.
        """
        first = next(iter(inspect.signature(self.factory).parameters.values()), None)
        required = first is not None and first.default is first.empty and first.kind.name.startswith("POSITIONAL")
        takes = first is not None and (required or first.name == "simulation")
        made = call_factory(self.name, self.factory, *([scenario.simulation] if takes else []))
        policy, wrapper = made if isinstance(made, tuple) and len(made) == 2 else (made, None)
        try:
            adapted = as_policy(policy).adapt(scenario)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from error
        return adapted if wrapper is None else _InWrapper(adapted, wrapper)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory for the default scenario; see `quadpend_baselines.Policy.predict`."""
        return self._default.predict(observation, state, episode_start, deterministic)

    @cached_property
    def _default(self) -> Policy:
        return self.adapt(Scenario())


class _InWrapper(PolicyWrapper):
    """A policy with a wrapper around the environment."""

    def __init__(self, policy: Policy, wrapper: Callable[[Any], VectorEnv[Any, Any, Any]]) -> None:
        super().__init__(policy)
        self._wrapper = wrapper

    def wrap(self, env: VectorEnv[Any, Any, Any]) -> VectorEnv[Any, Any, Any]:
        """Return the environment in the wrapper."""
        return self._wrapper(self.policy.wrap(env))
