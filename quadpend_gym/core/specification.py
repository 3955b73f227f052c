"""The specification of an environment, whose `to_json` refuses what JSON cannot represent."""

from collections.abc import Mapping
from dataclasses import fields
from functools import partial
from typing import Any

from gymnasium.envs.registration import EnvSpec

from quadpend_gym.core.models import to_plain_data


class QuadPendulumSpec(EnvSpec):
    """An `EnvSpec` that is never written as JSON without a model of the user's own class.

    Gymnasium would write the fields of such a model without its class.
    """

    def to_json(self) -> str:
        """Return the specification as JSON.

        Raises:
            TypeError: If an argument of the environment or of a wrapper holds a model whose class is in no registry.
        """
        for arguments in (self.kwargs, *(wrapper.kwargs for wrapper in self.additional_wrappers)):
            for name, value in (arguments or {}).items():
                to_plain_data(value, partial(_refuse, name))
        return super().to_json()


def _refuse(name: str, item: Any) -> None:
    hint = ", or give wind as a text 'module:factory'" if name == "wind" else ""
    raise TypeError(
        f"{name} cannot be written as JSON with {item!r}: use the models of this package{hint}, or add the class to"
        " KINDS of its kind of model"
    )


class Specification:
    """The attribute `spec` of an environment: a `QuadPendulumSpec` or None."""

    def __get__(self, env: Any, owner: Any = None) -> QuadPendulumSpec | None:
        return None if env is None else env.__dict__.get("_spec")

    def __set__(self, env: Any, spec: EnvSpec | None) -> None:
        if spec is None:
            env.__dict__["_spec"] = None
            return
        given = {item.name: getattr(spec, item.name) for item in fields(spec) if item.init}
        given["kwargs"] = _without_files(given["kwargs"], env.world.simulation.vehicle)
        env.__dict__["_spec"] = QuadPendulumSpec(**given)


def _without_files(arguments: Any, vehicle: Any) -> Any:
    """Return arguments with `vehicle` in place of its file, which may be another one when the environment is remade."""
    if not isinstance(arguments, Mapping):
        return arguments
    found = {
        name: _without_files(value, vehicle) if name == "simulation" else value for name, value in arguments.items()
    }
    if str(found.get("vehicle")).endswith(".toml"):
        found["vehicle"] = vehicle
    return found
