"""Vehicles as data: body, pole, rotors, drag and rate loop, with presets whose numbers name their sources."""

from quadpend_gym.vehicles.parameters import Parameters
from quadpend_gym.vehicles.parts import Drag, Pole, RateLoop, Rotors
from quadpend_gym.vehicles.poles import POLES, as_pole
from quadpend_gym.vehicles.registry import VEHICLES, as_vehicle
from quadpend_gym.vehicles.vehicle import Vehicle, hover_thrusts, hover_wrench, mixing, torque_limits

__all__ = [
    "POLES",
    "VEHICLES",
    "Drag",
    "Parameters",
    "Pole",
    "RateLoop",
    "Rotors",
    "Vehicle",
    "as_pole",
    "as_vehicle",
    "hover_thrusts",
    "hover_wrench",
    "mixing",
    "torque_limits",
]
