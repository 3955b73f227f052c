"""Scenarios: environments with wind, sensors, actuators and parameters, as data."""

from quadpend_gym.scenarios.names import short_name
from quadpend_gym.scenarios.own_models import check_own_models, own_models
from quadpend_gym.scenarios.scenario import (
    HELD_OUT,
    HOVER,
    SCENARIO_FILE,
    SCENARIOS,
    SETS,
    Scenario,
    as_scenario,
    expand_sets,
    find_scenario,
    name_or_json,
    names_without_files,
    scenario_data,
    scenario_file_hash,
    scenario_hash,
    split_changes,
    with_changes,
)

__all__ = [
    "HELD_OUT",
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
    "names_without_files",
    "own_models",
    "scenario_data",
    "scenario_file_hash",
    "scenario_hash",
    "short_name",
    "split_changes",
    "with_changes",
]
