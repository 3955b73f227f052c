"""Autopilots: real firmware in place of the rate loop."""

from quadpend_gym.autopilots.betaflight import *
