"""Policies of the user's own code: a text ``"module:factory"``, or the name of an installed plug-in.

A factory is a function or class. It is called with the nominal `Simulation` if it has one required argument or its
first argument is called ``simulation``, otherwise without arguments. It returns an object with the method `predict` of
`quadpend_baselines.Policy`, a torch module or a model of Stable-Baselines3. A factory that takes the simulation is
called again for every scenario with its simulation. If the factory takes none, the object may have a method
``with_simulation(simulation)`` that returns the policy for a scenario.

A package installs plug-ins by entry points of the group `PLUGINS`, each a name and a factory:

    [project.entry-points."quadpend.policies"]
    my-pd = "my_package.controllers:make"

Results of own policies are not cached, because the cache cannot see whether their code has changed, unless the policy
has an attribute `fingerprint`: a text that its author changes with its behaviour.
"""

import hashlib
import inspect
import sys
import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from quadpend_baselines import Policy
from quadpend_gym import Simulation
from quadpend_gym.core.factories import call_factory, find_factory, is_factory
from quadpend_train.policies.conversion import convert

PLUGINS = "quadpend.policies"
PROTOCOL = (
    "a policy is an object with predict(observation, state=None, episode_start=None, deterministic=True), which takes"
    " observations of shape (n, 36) and returns actions of shape (n, 4) in [-1, 1] and its memory"
)


@dataclass(frozen=True)
class FactoryPolicy:
    """A policy whose factory takes the simulation; the factory makes it anew for every simulation.

    Attributes:
        name: Name of the factory for error messages.
        factory: Function or class.
        policy: What the factory returned.
    """

    name: str
    factory: Callable[[Simulation], Any]
    policy: Any

    @property
    def fingerprint(self) -> Any:
        """The attribute `fingerprint` of the policy, or None."""
        return getattr(self.policy, "fingerprint", None)

    @property
    def observation_sizes(self) -> Any:
        """The attribute `observation_sizes` of the policy, which learned policies have, or None."""
        return getattr(self.policy, "observation_sizes", None)

    def with_simulation(self, simulation: Simulation) -> "FactoryPolicy":
        """Return the policy for another nominal simulation."""
        policy = _made(self.name, call_factory(self.name, self.factory, simulation))
        return FactoryPolicy(self.name, self.factory, policy)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """Return action and memory; see `quadpend_baselines.Policy.predict`."""
        result: tuple[Any, Any] = self.policy.predict(observation, state, episode_start, deterministic=deterministic)
        return result


@lru_cache(maxsize=1)
def _installed() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=PLUGINS))


def plugins(taken: Collection[str] = ()) -> dict[str, EntryPoint]:
    """Return the installed plug-ins by name.

    Args:
        taken: Names that a plug-in may not have; such a plug-in is left out with a warning.
    """
    found = {}
    for plugin in _installed():
        if plugin.name in taken or plugin.name in found:
            package = plugin.dist.name if plugin.dist else plugin.value
            warnings.warn(f"the plug-in {plugin.name!r} of {package} is ignored: the name is taken", stacklevel=2)
        else:
            found[plugin.name] = plugin
    return found


def own_factory(name: str, taken: Collection[str] = ()) -> str | None:
    """Return the text ``"module:factory"`` of a name: the name itself, or the value of a plug-in; None for others.

    Args:
        name: Name of a policy.
        taken: Names that a plug-in may not have.
    """
    if is_factory(name):
        return name
    plugin = plugins(taken).get(name)
    return f"{plugin.module}:{plugin.attr}" if plugin else None


def make_policy(factory_name: str) -> Policy:
    """Return the policy that a factory makes for the nominal simulation.

    Args:
        factory_name: Text ``"module:factory"``.

    Raises:
        ValueError: If there is no such factory, it needs other arguments, it fails, or it returns no policy.
    """
    factory = find_factory(factory_name)
    if not _takes_simulation(factory_name, factory):
        return _made(factory_name, call_factory(factory_name, factory))  # type: ignore[no-any-return]
    policy = _made(factory_name, call_factory(factory_name, factory, Simulation()))
    return FactoryPolicy(factory_name, factory, policy)


def _made(name: str, value: Any) -> Any:
    """Return what a factory made as a policy, after checking it."""
    try:
        return check_predict(name, convert(value))
    except ValueError as error:
        raise error if name in str(error) else ValueError(f"{name}: {error}") from error


def check_predict(name: str, policy: Any) -> Any:
    """Return `policy` after checking that it has the method `predict` with the arguments of a policy.

    Raises:
        ValueError: If it has not.
    """
    predict = getattr(policy, "predict", None)
    if isinstance(policy, type) or not callable(predict):
        raise ValueError(f"{name} is no policy but {policy!r}: {PROTOCOL}")
    try:
        inspect.signature(predict).bind(None, None, None, deterministic=True)
    except TypeError as error:
        raise ValueError(f"{name} has a predict{inspect.signature(predict)}: {PROTOCOL}") from error
    return policy


def fingerprint(policy: Any) -> str | None:
    """Return the fingerprint of an own policy with the name of its class; None if it has no `fingerprint`."""
    own = getattr(policy, "fingerprint", None)
    kind = type(policy.policy if isinstance(policy, FactoryPolicy) else policy)
    return f"{kind.__module__}.{kind.__qualname__} {own}" if isinstance(own, str) else None


def source(factory_name: str) -> str:
    """Return the name of a factory and the hash of the file of its module, for the provenance of results."""
    find_factory(factory_name)
    file = getattr(sys.modules[factory_name.partition(":")[0]], "__file__", None)
    return f"{factory_name} {hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ''}".strip()


def _takes_simulation(name: str, factory: Callable[..., Any]) -> bool:
    """Return whether a factory is called with the simulation."""
    try:
        signature = inspect.signature(factory)
    except ValueError:  # a class of a compiled module
        return False
    named = [item for item in signature.parameters.values() if item.kind.name not in ("VAR_POSITIONAL", "VAR_KEYWORD")]
    required = [item for item in named if item.default is item.empty]
    if len(required) > 1 or any(item.kind is item.KEYWORD_ONLY for item in required):
        raise ValueError(f"{name} must be callable without arguments or with the simulation alone, not as {signature}")
    return bool(required) or (bool(named) and named[0].name == "simulation")
