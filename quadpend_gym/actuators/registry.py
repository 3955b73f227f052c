"""The actuator models by name, and the check of their order."""

from collections.abc import Sequence
from typing import Any

from quadpend_gym.actuators.models import ActionDelay, Actuator, MotorLag, RateLimit, RotorFault, Rotors
from quadpend_gym.core.models import Registry
from quadpend_gym.physics.parameters import Simulation

KINDS: dict[str, type[Any]] = {
    "action_delay": ActionDelay,
    "motor_lag": MotorLag,
    "rate_limit": RateLimit,
    "rotors": Rotors,
    "rotor_fault": RotorFault,
}


_FAMILY = Registry("actuator", "an actuator model", Actuator, KINDS)


def as_actuators(value: Any) -> tuple[Any, ...]:
    """The actuator models that `value` is or describes; see `models.Family.members`."""
    return _FAMILY.members(value)


def check_chain(models: Sequence[Any], simulation: Simulation) -> None:
    """Check that actuators make sense in this order.

    Raises:
        ValueError: there are rotors twice, a rotor fails that is not there, or the rotors are too strong.
    """
    places = [i for i, model in enumerate(models) if isinstance(model, Rotors)]
    if len(places) > 1:
        raise ValueError("the action can be mixed from rotors only once: leave one Rotors out")
    if places:
        models[places[0]].mixing(simulation)
    for i, model in enumerate(models):
        if isinstance(model, RotorFault) and not (places and i < places[0]):
            raise ValueError("a RotorFault needs rotors: put it before Rotors in the list, or around them as a wrapper")
