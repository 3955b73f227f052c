"""The sensor models by name."""

from typing import Any

from quadpend_gym.core.models import Registry
from quadpend_gym.sensors.models import Delay, Dropout, Noise, Sensor

KINDS: dict[str, type[Any]] = {"noise": Noise, "delay": Delay, "dropout": Dropout}


_FAMILY = Registry("sensor", "a sensor model", Sensor, KINDS)


def as_sensors(value: Any) -> tuple[Any, ...]:
    """The sensor models that `value` is or describes; see `models.Family.members`."""
    return _FAMILY.members(value)
