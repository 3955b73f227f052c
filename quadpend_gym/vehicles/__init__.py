"""Vehicles as data: body, pole, rotors, drag and rate loop, with presets whose numbers name their sources."""

from quadpend_gym.vehicles.parameters import PARAMETER_NAMES, Parameters
from quadpend_gym.vehicles.parts import POLES, Drag, Pole, RateLoop, Rotors
from quadpend_gym.vehicles.simulation import CONTROL_PERIOD, Simulation
from quadpend_gym.vehicles.vehicle import VEHICLES, Vehicle, as_vehicle, hover_wrench, mixing, torque_limits

PAPER = VEHICLES["paper"].parameters

__all__ = [
    "CONTROL_PERIOD",
    "PAPER",
    "PARAMETER_NAMES",
    "POLES",
    "VEHICLES",
    "Drag",
    "Parameters",
    "Pole",
    "RateLoop",
    "Rotors",
    "Simulation",
    "Vehicle",
    "as_vehicle",
    "hover_wrench",
    "mixing",
    "torque_limits",
]
