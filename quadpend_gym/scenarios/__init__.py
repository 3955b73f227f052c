"""Scenarios: environments with their task, vehicle, wind, sensors, actuators and parameters, as data.

The TOML files of this folder define the scenarios of this package, so that a name always means the same episodes:
`scenarios.toml` those of the paper's vehicle, `hummingbird.toml` those of a real one, `flight.toml` those of the flight
benchmark, and `tasks.toml` those of other tasks. They also name sets of scenarios: ``training`` and others that begin
so, for training and tuning, and sets that are held out, such as ``test``.
"""

from quadpend_gym.scenarios.library import *
from quadpend_gym.scenarios.scenario import *
