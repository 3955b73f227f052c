"""Sensor models, which change the measured state from which the observation is computed."""

from quadpend_gym.sensors.models import Channel, Delay, Dropout, Noise, SampleHold, Sensor
from quadpend_gym.sensors.registry import KINDS, as_sensors, check_periods

__all__ = ["KINDS", "Channel", "Delay", "Dropout", "Noise", "SampleHold", "Sensor", "as_sensors", "check_periods"]
