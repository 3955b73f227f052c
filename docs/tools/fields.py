"""Write the lists of fields with their defaults: ``python -m docs.tools.fields``."""

from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from experiments.pages import fill
from quadpend_gym import ReferenceSettings, StartSettings
from quadpend_gym.actuators import KINDS as ACTUATORS
from quadpend_gym.core.settings import declared
from quadpend_gym.randomization import Around, LoopChanges, LoopRanges
from quadpend_gym.sensors import KINDS as SENSORS
from quadpend_gym.sensors import Channel
from quadpend_gym.tasks.jumps import Jumps
from quadpend_gym.vehicles import Drag, Pole, RateLoop, Rotors, Simulation, Vehicle
from quadpend_gym.wind import KINDS as WINDS
from quadpend_train.common.declarations import meanings

PAGE = Path(__file__).parents[1] / "reference/fields.md"
GROUPS: dict[str, tuple[type[Any], ...]] = {
    "simulation": (Simulation, Around, LoopRanges, LoopChanges),
    "task": (ReferenceSettings, StartSettings, Jumps),
    "vehicles": (Vehicle, Pole, Rotors, Drag, RateLoop),
    "wind": tuple(WINDS.values()),
    "sensors": (Channel, *SENSORS.values()),
    "actuators": tuple(ACTUATORS.values()),
}


def _default(item: Any) -> str:
    if item.default is MISSING:
        return "–"
    value = item.default
    return ", ".join(map(_value, value)) if isinstance(value, tuple) else _value(value)


def _value(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _lines(kinds: tuple[type[Any], ...]) -> Iterator[str]:
    """Yield the lines of a group; a field that several of its classes share has one line."""
    found: dict[tuple[str, str], list[str]] = {}  # names of classes by field and the rest of the line
    for kind in kinds:
        items, texts = {item.name: item for item in fields(kind)}, meanings(kind)
        for name, _, bounds in declared(kind):
            value = f"{_default(items[name])} {bounds.unit}".strip()
            found.setdefault((name, f" ({value}): {texts[name]}"), []).append(kind.__name__)
    for (name, rest), (first, *others) in found.items():
        also = "".join(f", `{other}`" for other in others)
        yield f"- `{first}.{name}`{also}{rest}"


def tables() -> dict[str, str]:
    """Return the generated lists of the page by name."""
    return {name: "\n".join(_lines(kinds)) for name, kinds in GROUPS.items()}


if __name__ == "__main__":
    fill(PAGE, tables())
