"""Vehicles as data: body, pole, rotors, drag and rate loop, with presets whose numbers name their sources."""

from quadpend_gym.vehicles.parameters import *
from quadpend_gym.vehicles.parts import *
from quadpend_gym.vehicles.plausibility import *
from quadpend_gym.vehicles.simulation import *
from quadpend_gym.vehicles.vehicle import *
from quadpend_gym.vehicles.vehicle import VEHICLES

PAPER = VEHICLES["paper"].parameters
