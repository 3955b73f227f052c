"""Scenarios: which environment, with which wind, sensors, actuators and parameters."""

from quadpend_train.scenarios.scenario import (
    ENVIRONMENTS,
    FILE,
    HOVER,
    SCENARIOS,
    SETS,
    Scenario,
    expand,
    file_hash,
    find_scenario,
    resolve,
    scenario_hash,
)

__all__ = [
    "ENVIRONMENTS",
    "FILE",
    "HOVER",
    "SCENARIOS",
    "SETS",
    "Scenario",
    "expand",
    "file_hash",
    "find_scenario",
    "resolve",
    "scenario_hash",
]
