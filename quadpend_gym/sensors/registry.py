"""Kinds of sensor models by name, and the check of their periods."""

from collections.abc import Sequence
from typing import Any

from quadpend_gym.sensors.models import SENSORS, Delay, Dropout, Noise, SampleHold

KINDS = SENSORS.kinds

KINDS |= {
    "noise": Noise,
    "delay": Delay,
    "dropout": Dropout,
    "sample_hold": SampleHold,
}


def as_sensors(value: Any) -> tuple[Any, ...]:
    """Convert `value` to a tuple of sensor models; see `quadpend_gym.core.models.Registry.parse`."""
    return SENSORS.parse(value)


def check_periods(models: Sequence[Any], control_period: float) -> None:
    """Check that the sensors have samples at the times of control steps.

    Args:
        models: Sensor models.
        control_period: Duration of a control step, s.

    Raises:
        ValueError: If the period of a `SampleHold` is neither a whole multiple of the control period nor divides it.
    """
    for model in models:
        if isinstance(model, SampleHold):
            model.steps(control_period)
