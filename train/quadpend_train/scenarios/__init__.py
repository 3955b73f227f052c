"""Scenarios: environments with wind, sensors, actuators and parameters, as data."""

from quadpend_train.scenarios.scenario import (
    ENVIRONMENTS,
    HOVER,
    SCENARIO_FILE,
    SCENARIOS,
    SETS,
    Scenario,
    expand_sets,
    find_scenario,
    name_or_json,
    scenario_file_hash,
    scenario_hash,
)

__all__ = [
    "ENVIRONMENTS",
    "HOVER",
    "SCENARIOS",
    "SCENARIO_FILE",
    "SETS",
    "Scenario",
    "expand_sets",
    "find_scenario",
    "name_or_json",
    "scenario_file_hash",
    "scenario_hash",
]
