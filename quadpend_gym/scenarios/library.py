"""The scenarios of this package and their sets, and scenarios from names, files, JSON and the user's own code."""

from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import field, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from gymnasium import logger

from quadpend_gym.core.factories import call_factory, find_factory, is_factory, split_name, split_text
from quadpend_gym.core.files import parse_mapping, read_mapping, readable
from quadpend_gym.core.models import FromFactory, to_plain_data
from quadpend_gym.core.settings import parse, plain, settings, suggest
from quadpend_gym.randomization import RangesField
from quadpend_gym.scenarios.scenario import Scenario, substeps_in
from quadpend_gym.tasks.task import Task, TaskField
from quadpend_gym.vehicles import CONTROL_PERIOD
from quadpend_gym.vehicles.vehicle import VehicleField

__all__ = [
    "HELD_OUT",
    "SCENARIOS",
    "SETS",
    "as_scenario",
    "find_scenario",
    "find_scenarios",
    "own_models",
    "refuse_held_out",
]

# Sets and scenarios for results only, except what is also in a set for training; of other tasks, only seeds are.
HELD_OUT = (
    "test",
    "test-hummingbird",
    "as-flown",
    "flight",
    "events",
    "recovery-flight",
    "flight_onset",
    "flight_unknown",
)
_DISTURBANCES = "task", "sensors", "actuators", "parameters", "loop", "latency", "observation"
_READING: ContextVar[tuple[Path, ...]] = ContextVar(
    "_READING", default=()
)  # files, of which one is the base of another


@settings
class _File:
    """A file of many scenarios."""

    scenarios: dict[str, dict[str, Any]]
    sets: dict[str, tuple[str, ...]] = field(default_factory=dict)
    defaults: dict[str, Any] = field(default_factory=dict)


def read_scenarios(path: Path) -> tuple[dict[str, Scenario], dict[str, tuple[str, ...]]]:
    """Return the scenarios and the sets of a TOML or JSON file.

    The file has the fields of one `Scenario`, or the tables ``scenarios`` (scenarios by name), ``sets`` (names of
    scenarios, or of sets of scenarios, by the name of the set) and ``defaults`` (fields of all scenarios). A field
    ``base`` names a scenario, and the others replace its fields, see `as_scenario`.
    """
    if (file := path.resolve()) in _READING.get():
        raise ValueError(f"base must be a scenario of this package or of another file, not of {str(path)!r} itself")
    token = _READING.set((*_READING.get(), file))
    try:
        data = read_mapping(path)
        if "scenarios" not in data:
            name = readable(path.stem)
            return {name: _parse({"name": name, **data})}, {}
        given = parse(_File, data, "the file")
        scenarios = {
            name: _parse({"name": name, **given.defaults, **own}, name) for name, own in given.scenarios.items()
        }
        sets = {
            name: tuple(one for item in items for one in given.sets.get(item, (item,)))
            for name, items in given.sets.items()
        }
        for name, members in sets.items():
            if unknown := set(members) - scenarios.keys():
                raise ValueError(f"the set {name!r} has no scenario {min(unknown)!r}{suggest(min(unknown), scenarios)}")
        return scenarios, sets
    except OSError as error:
        raise ValueError(f"the scenario file {str(path)!r} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    finally:
        _READING.reset(token)


def _parse(data: Mapping[str, Any], what: str = "scenario") -> Scenario:
    """Return the scenario with the fields of a mapping, and otherwise those of its ``base`` but for the names."""
    own = {"name": "", "description": "", **data}
    if "base" not in own:
        return parse(Scenario, own, what)
    if (base := own.pop("base")) is None:
        raise ValueError("base must be a Scenario, its name or a mapping of its fields, not None")
    return _changed(as_scenario(base), own)


@cache
def shipped() -> tuple[dict[str, Scenario], dict[str, tuple[str, ...]]]:
    """Return the scenarios and the sets of this package by name."""
    scenarios: dict[str, Scenario] = {}
    sets: dict[str, tuple[str, ...]] = {}
    for path in sorted(Path(__file__).parent.glob("*.toml"), key=lambda path: (path.stem != "scenarios", path.stem)):
        found, named = read_scenarios(path)
        scenarios |= found
        sets |= named
    return scenarios, sets


def find_scenarios(names: str | Iterable[Any]) -> dict[str, Scenario]:
    """Return scenarios by name; equal names count once.

    Each is a `Scenario`, a mapping of its fields, or a text: the name of a scenario or of a set of this package; the
    path of a TOML or JSON file, whose scenarios all count, or ``"mine.toml:name"`` for a scenario or a set in it; JSON
    that begins with a brace; or ``"module:factory"``, a function that returns a `Scenario` or a wind. NAME=TEXT gives
    another name, and TEXT@VEHICLE another vehicle, see `Scenario.with_vehicle`.
    """
    found: dict[str, Scenario] = {}
    for item in [names] if isinstance(names, str) else names:
        for scenario in _scenarios(item) if isinstance(item, str) else [as_scenario(item)]:
            key = scenario.name or f"scenario {len(found) + 1}"
            if found.setdefault(key, scenario) != scenario:
                raise ValueError(f"two scenarios have the name {key!r}: give each its own, as NAME=SCENARIO")
    return found


def find_scenario(name: str | Scenario) -> Scenario:
    """Return one scenario, see `find_scenarios`."""
    if isinstance(name, Scenario):
        return name
    found = _scenarios(name)
    if len(found) > 1:
        names = ", ".join(scenario.name for scenario in found)
        raise ValueError(f"{name!r} is a set of scenarios: choose one of {names}")
    return found[0]


def as_scenario(value: Any, own_task: str = "", **parts: Any) -> Scenario:
    """Return a scenario from itself, a text that `find_scenario` takes, a mapping of its fields, or None.

    `parts` replace its fields, as the other fields of a mapping with a ``base`` replace those of that scenario. With
    `own_task`, the name of that of an environment's id, it has this task, which a mapping in `parts` changes. A mapping
    without a ``kind`` changes the fields that it names of the scenario's own part, such as its task. With another
    vehicle, the forces of its wind are scaled, see `Scenario.with_vehicle`. With another period alone, its substeps are
    as long as before, or shorter.
    """
    if own_task:
        parts["task"] = _merged(TaskField.function(own_task), parts.get("task", own_task))
    if value is None or isinstance(value, Mapping):
        given = value or {}
        if "base" in given:
            return as_scenario(_parse(given), **parts)
        own = {name: _PARSED[name](part) if name in _PARSED else part for name, part in given.items()}
        return parse(Scenario, {**given, **_merged_parts(own, parts)}, "scenario")
    scenario = find_scenario(value) if isinstance(value, str) else value
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario must be a Scenario, its name or a mapping of its fields, not {value!r}")
    return _changed(scenario, parts)


def _changed(scenario: Scenario, parts: Mapping[str, Any]) -> Scenario:
    """Return a scenario with other parts, see `as_scenario`."""
    parts = _merged_parts(vars(scenario), parts)
    if vehicle := {name: parts.pop(name) for name in ("vehicle", "interface") if name in parts}:
        scenario = scenario.with_vehicle(**vehicle)
    if "latency" in parts and "loop" not in parts and scenario.loop and scenario.loop.latency:
        raise ValueError("latency: the scenario draws it for each episode: give loop={'latency': (low, high)} instead")
    return replace(scenario, **parts)


_PARSED = {"task": TaskField.function, "vehicle": VehicleField.function, "parameters": RangesField.function}


def _merged_parts(own: Mapping[str, Any], parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts that replace those of a scenario, whose `own` fields are given."""
    merged = {name: _merged(own.get(name), part) for name, part in parts.items()}
    period, substeps = plain(parts.get("period")), own.get("substeps")
    if substeps and "substeps" not in parts and isinstance(period, int | float):
        merged["substeps"] = max(substeps_in(period, own.get("period", CONTROL_PERIOD) / substeps), 1)
    task, before, default = parts.get("task"), own.get("task"), Task()
    if isinstance(task, Task) and isinstance(before, Task):
        same = [item.name for item in fields(Task) if getattr(task, item.name) == getattr(default, item.name)]
        if lost := [name for name in same if getattr(before, name) != getattr(default, name)]:
            logger.warn(
                "task, a whole Task, replaces %s of the scenario by those of 'track': give a mapping of the fields to"
                " change, such as task={'reward': …}, to keep them",
                " and ".join(lost),
            )
    return merged


def _merged(own: Any, part: Any) -> Any:
    """Return a part; if it is a mapping of fields of the scenario's `own` part, with that one's other fields."""
    data = {item.name: getattr(own, item.name) for item in fields(own)} if is_dataclass(own) else own
    if (
        not isinstance(part, Mapping)
        or not isinstance(data, Mapping)
        or "kind" in part
        or not data.keys() & part.keys()
    ):
        return part
    return {**data, **{name: _merged(data.get(name), value) for name, value in part.items()}}


def _scenarios(text: str) -> list[Scenario]:
    scenarios, sets = shipped()
    if text in scenarios:
        return [scenarios[text]]
    if text in sets:
        return [scenarios[member] for member in sets[text]]
    if text.lstrip().startswith("{"):
        return [_parse(parse_mapping(text, "the scenario"))]
    name, value = split_name(text)
    if name:
        return [replace(find_scenario(value), name=name)]
    text, *vehicle = split_text(text, "@")
    if vehicle:
        return [scenario.with_vehicle("@".join(vehicle)) for scenario in _scenarios(text)]
    file, _, member = (text, "", "") if Path(text).is_file() else text.partition(":")
    path = Path(file)
    if path.suffix in (".toml", ".json"):
        own, own_sets = read_scenarios(path)
        if member and member not in own | own_sets:
            raise ValueError(f"{file} has no {member!r}{suggest(member, [*own, *own_sets])}")
        return [own[name] for name in own_sets.get(member, (member,) if member else own)]
    if is_factory(text):
        made = call_factory(text, find_factory(text))
        return [made if isinstance(made, Scenario) else Scenario(wind=text, name=text)]
    raise ValueError(
        f"there is no scenario {text!r}{suggest(text, [*scenarios, *sets])}; `quadpend list scenarios` lists them; or"
        " give the path of a TOML or JSON file, JSON, or 'module:factory'"
    )


def refuse_held_out(names: Iterable[Any]) -> None:
    """Raise ValueError for what contains a scenario that is for results only: not for training and not for tuning.

    Names, files and vehicles do not matter, only what disturbs the flight: the fields `_DISTURBANCES` and the wind.
    """
    sets = [name for name in SETS if name.startswith("training")]
    training = {member for name in sets for member in SETS[name]}
    held_out = [SCENARIOS[member] for name in HELD_OUT for member in SETS.get(name, (name,)) if member not in training]
    for name in names:
        for scenario in find_scenarios([name]).values():
            if found := [item.name for item in held_out if _disturbs_alike(scenario, item)]:
                given = scenario.name if isinstance(name, Scenario) else name
                what = "" if given == found[0] else f" with {found[0]!r}"
                raise ValueError(
                    f"scenarios cannot be {given!r}, which is held out{what}: use one of {', '.join(sets)}, or others"
                )


def _disturbs_alike(scenario: Scenario, other: Scenario) -> bool:
    """Return whether a scenario is another one but for its vehicle and what does not disturb the flight."""
    if any(getattr(scenario, name) != getattr(other, name) for name in _DISTURBANCES):
        return False
    return bool(scenario.wind == other.with_vehicle(scenario.vehicle, scenario.interface).wind)


class _Shipped(Mapping[str, Any]):
    """A part of `shipped`, which is read when it is first used."""

    def __init__(self, part: int) -> None:
        self._part = part

    def __getitem__(self, name: str) -> Any:
        return shipped()[self._part][name]

    def __iter__(self) -> Iterator[str]:
        return iter(shipped()[self._part])

    def __len__(self) -> int:
        return len(shipped()[self._part])


SCENARIOS: Mapping[str, Scenario] = _Shipped(0)  # of this package, by name
SETS: Mapping[str, tuple[str, ...]] = _Shipped(1)  # names of scenarios, by the name of the set


def own_models(value: Any) -> list[Any]:
    """Return all objects in a scenario that are made by the user's own code, which no hash of a scenario covers."""
    found: list[Any] = []
    to_plain_data(value, found.append, (FromFactory,))
    return found
