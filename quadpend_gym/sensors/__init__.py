"""Sensor models, which change the measured state from which the observation is computed."""

from quadpend_gym.sensors.models import Channel, Delay, Dropout, Noise, Sensor
from quadpend_gym.sensors.registry import KINDS, as_sensors

__all__ = ["KINDS", "Channel", "Delay", "Dropout", "Noise", "Sensor", "as_sensors"]
