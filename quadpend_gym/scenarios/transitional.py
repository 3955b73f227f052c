"""Names of scenarios as texts, until all callers carry scenarios."""

import json
from collections.abc import Sequence
from typing import Any

from quadpend_gym.scenarios import library as _library
from quadpend_gym.scenarios.scenario import Scenario, scenario_data
from quadpend_gym.vehicles import INTERFACES, VEHICLES

_SEPARATOR = " · "
SCENARIOS, SETS = _library.shipped()
HELD_OUT = _library.held_out()


def with_changes(name: str, vehicle: str | None = None, interface: str | None = None) -> str:
    """Return the name of a scenario or a set with another vehicle or interface, such as "windy · crazyflie"."""
    return _SEPARATOR.join(part for part in (name, vehicle, interface) if part)


def split_changes(name: str) -> tuple[str, str | None, str | None]:
    """Return the scenario or the set in a name of `with_changes`, and its vehicle and interface, None if not given."""
    head, brace, tail = name.rpartition("}")  # JSON may contain the separator
    first, *changes = tail.split(_SEPARATOR)
    interface = changes.pop() if changes and changes[-1] in INTERFACES else None
    return head + brace + first, _SEPARATOR.join(changes) or None, interface


def find_scenario(name: Any) -> Scenario:
    """Return a scenario, also by a name of `with_changes`."""
    if isinstance(name, Scenario):
        return name
    base, vehicle, interface = split_changes(name)
    found = _library.find_scenario(base)
    return found.with_vehicle(vehicle, interface) if vehicle or interface else found


def expand_sets(names: Sequence[str]) -> list[str]:
    """Return `names` with each name of a set, also with a vehicle, replaced by the names of its scenarios."""
    found = [split_changes(name) for name in names]
    return [with_changes(member, *changes) for name, *changes in found for member in SETS.get(name, (name,))]


def name_or_json(name: str) -> str:
    """Return the scenario as JSON, which does not depend on a file."""
    base, vehicle, _ = split_changes(name)
    lasting = base in SCENARIOS and (vehicle is None or vehicle in VEHICLES)
    return name if lasting else json.dumps(scenario_data(find_scenario(name)))


def names_without_files(name: str) -> list[str]:
    """Return a scenario as by `name_or_json`, or the name of a set."""
    base, vehicle, _ = split_changes(name)
    if base in SETS and (vehicle is None or vehicle in VEHICLES):
        return [name]
    return [name_or_json(member) for member in expand_sets([name])]


def short_name(name: str) -> str:
    """Return the beginning of a name."""
    return name[:60]
