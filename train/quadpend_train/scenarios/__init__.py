"""Scenarios: environments with wind, sensors, actuators and parameters, as data."""

from quadpend_train.scenarios.scenario import (
    ENVIRONMENTS,
    HOVER,
    SCENARIO_FILE,
    SCENARIOS,
    SETS,
    Scenario,
    as_scenario,
    check_own_models,
    expand_sets,
    find_scenario,
    name_or_json,
    own_models,
    scenario_data,
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
    "as_scenario",
    "check_own_models",
    "expand_sets",
    "find_scenario",
    "name_or_json",
    "own_models",
    "scenario_data",
    "scenario_file_hash",
    "scenario_hash",
]
