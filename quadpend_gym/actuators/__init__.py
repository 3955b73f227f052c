"""Actuator models, which change the action between the policy and the quadrotor."""

from quadpend_gym.actuators.models import *
