"""Actuator models, which change the action between the policy and the quadrotor."""

from quadpend_gym.actuators.models import (
    ActionDelay,
    Actuator,
    GyroBias,
    MotorLag,
    PacketLoss,
    RateLimit,
    RotorFault,
    Rotors,
)
from quadpend_gym.actuators.registry import KINDS, as_actuators, check_chain

__all__ = [
    "KINDS",
    "ActionDelay",
    "Actuator",
    "GyroBias",
    "MotorLag",
    "PacketLoss",
    "RateLimit",
    "RotorFault",
    "Rotors",
    "as_actuators",
    "check_chain",
]
