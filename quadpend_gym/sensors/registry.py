"""Kinds of sensor models by name."""

from typing import Any

from quadpend_gym.sensors.models import SENSORS, Delay, Dropout, Noise

KINDS = SENSORS.kinds

KINDS |= {
    "noise": Noise,
    "delay": Delay,
    "dropout": Dropout,
}


def as_sensors(value: Any) -> tuple[Any, ...]:
    """Convert `value` to a tuple of sensor models; see `quadpend_gym.core.models.Registry.parse`."""
    return SENSORS.parse(value)
