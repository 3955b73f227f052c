"""Sensor models, which change the measured state from which the observation is computed."""

from quadpend_gym.sensors.models import *
