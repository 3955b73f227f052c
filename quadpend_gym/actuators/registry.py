"""Kinds of actuator models by name, and the check of their order."""

from collections.abc import Sequence
from typing import Any

from quadpend_gym.actuators.models import (
    ACTUATORS,
    ActionDelay,
    GyroBias,
    MotorLag,
    PacketLoss,
    RateLimit,
    RotorFault,
    Rotors,
)
from quadpend_gym.physics.parameters import Simulation

KINDS = ACTUATORS.kinds

KINDS |= {
    "action_delay": ActionDelay,
    "motor_lag": MotorLag,
    "rate_limit": RateLimit,
    "packet_loss": PacketLoss,
    "gyro_bias": GyroBias,
    "rotors": Rotors,
    "rotor_fault": RotorFault,
}


def as_actuators(value: Any) -> tuple[Any, ...]:
    """Convert `value` to a tuple of actuator models; see `quadpend_gym.core.models.Registry.parse`."""
    return ACTUATORS.parse(value)


def check_chain(models: Sequence[Any], simulation: Simulation) -> None:
    """Check that the actuators fit together in this order.

    Args:
        models: Actuator models in the order in which they change the action.
        simulation: Simulation whose interface the models need, and whose command limits the rotors must not exceed.

    Raises:
        ValueError: If there is more than one `Rotors`, a `RotorFault` is not followed by `Rotors`, or the rotors exceed
            the command limits, a `GyroBias` has no interface "body_rates", or `Rotors` have no interface "wrench".
    """
    for kind, interface in ((GyroBias, "body_rates"), (Rotors, "wrench")):
        if simulation.interface != interface and any(isinstance(model, kind) for model in models):
            raise ValueError(f'{kind.__name__} needs the interface "{interface}", not "{simulation.interface}"')
    rotors = [i for i, model in enumerate(models) if isinstance(model, Rotors)]
    if len(rotors) > 1:
        raise ValueError(f"actuators may contain Rotors only once, not {len(rotors)} times")
    if rotors:
        models[rotors[0]].mixing(simulation)
    for i, model in enumerate(models):
        if isinstance(model, RotorFault) and not (rotors and i < rotors[0]):
            raise ValueError(
                "a RotorFault needs rotors: list it before Rotors, or wrap it around an environment that has Rotors"
            )
