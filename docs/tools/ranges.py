"""Write the tables of fields with their ranges: ``python -m docs.tools.ranges``."""

from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from docs.tools.declarations import meanings
from experiments.pages import fill
from quadpend_gym import Limits, Reference, ReferenceSettings, RewardWeights, StartSettings
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.core.settings import Range, declared
from quadpend_gym.randomization import Around, LoopChanges, LoopRanges
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.sensors import Channel
from quadpend_gym.tasks.jumps import Jumps
from quadpend_gym.tasks.trajectories import Waypoints
from quadpend_gym.vehicles import Drag, Pole, RateLoop, Rotors, Simulation, Vehicle
from quadpend_gym.wind import KINDS as WINDS

PAGE = Path(__file__).parents[1] / "reference/ranges.md"
GROUPS: dict[str, tuple[type[Any], ...]] = {
    "simulation": (Simulation, Around, LoopRanges, LoopChanges),
    "task": (ReferenceSettings, StartSettings, Jumps, Limits, RewardWeights, Reference, Waypoints),
    "vehicles": (Vehicle, Pole, Rotors, Drag, RateLoop),
    "wind": tuple(WINDS.values()),
    "sensors": (Channel, *SENSORS.values()),
    "actuators": tuple(ACTUATORS.values()),
}


def _number(value: float) -> str:
    return f"{value:,.15g}" if 1e-3 <= abs(value) < 1e6 or value == 0.0 else f"{value:g}"


def _default(item: Any) -> str:
    if item.default is MISSING:
        return "–"
    value = item.default
    return ", ".join(map(_value, value)) if isinstance(value, tuple) else _value(value)


def _value(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def limits(bounds: Range) -> str:
    """Return a range without its unit."""
    return f"{_number(bounds.low)} to {_number(bounds.high)}"


def _rows(kind: type[Any]) -> Iterator[str]:
    items, texts = {item.name: item for item in fields(kind)}, meanings(kind)
    for name, _, bounds in declared(kind):
        cells = [bounds.unit or "1", limits(bounds), _default(items[name]), texts[name]]
        yield f"| `{kind.__name__}.{name}` | {' | '.join(cells)} |"


def tables() -> dict[str, str]:
    """Return the generated tables of the page by name."""
    head = ["| field | unit | range | default | meaning |", "|---|---|---|---|---|"]
    return {name: "\n".join([*head, *(row for kind in kinds for row in _rows(kind))]) for name, kinds in GROUPS.items()}


if __name__ == "__main__":
    fill(PAGE, tables())
