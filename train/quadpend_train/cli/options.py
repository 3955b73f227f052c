"""Helpers of several commands: ranges of options and NAME=SCENARIO.

The options `--vehicle`, `--interface`, `--autopilot` and `--latency` apply to all scenarios of a command.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import TypeAdapter, ValidationError

from quadpend_gym.autopilots import as_autopilot
from quadpend_gym.core.settings import Range
from quadpend_gym.scenarios import Scenario, find_scenarios
from quadpend_gym.scenarios.library import as_scenario
from quadpend_gym.vehicles import doubts

# Types of options with their ranges, which `checked` applies: a typing error must not use up the memory or the year.
Episodes = Annotated[int, Range(1, 100_000)]
Trials = Annotated[int, Range(1, 1_000_000)]
Seed = Annotated[int, Range(0, 2**62)]
Jobs = Annotated[int, Range(1, 1024)]
Latency = Annotated[float | None, Range(0.0, 1.0, "s")]


def checked(function: Callable[..., None]) -> Callable[..., None]:
    """Return the function of a command with a check of the options whose types declare a range."""
    hints = get_type_hints(function, include_extras=True)

    @wraps(function)
    def call(**options: Any) -> None:
        try:
            for name in options:
                if any(isinstance(item, Range) for item in get_args(hints[name])):
                    TypeAdapter(hints[name]).validate_python(options[name])
        except ValidationError as error:
            message = error.errors()[0]["msg"].replace("Input should", "must")
            raise ValueError(f"{name} {message}, not {options[name]}") from None
        function(**options)

    return call


def named_scenarios(
    scenarios: Sequence[str | Scenario],
    vehicle: str | None = None,
    interface: str | None = None,
    autopilot: str | None = None,
    latency: float | None = None,
) -> dict[str, Scenario]:
    """Return scenarios by name, see `find_scenarios`, all of them with what is given.

    An autopilot is built and configured. Doubts about vehicles are printed.
    """
    found = find_scenarios(scenarios)
    if vehicle is not None or interface is not None:
        found = find_scenarios(scenario.with_vehicle(vehicle, interface) for scenario in found.values())
    if latency is not None:
        late = (as_scenario(one, latency=latency, name=f"{name} · {1e3 * latency:g} ms") for name, one in found.items())
        found = find_scenarios(late)
    known = {(each.vehicle.name, doubt) for each in found.values() for doubt in doubts(each.simulation)}
    for name, sentence in sorted(known):
        print(f"Warning: vehicle {name}: {sentence}.", file=sys.stderr)
    firmware = as_autopilot(autopilot)
    if firmware is None:
        return found
    with_firmware = [replace(one, autopilot=firmware, name=f"{name} · {autopilot}") for name, one in found.items()]
    for scenario in with_firmware:
        firmware.prepare(scenario.simulation)
    return find_scenarios(with_firmware)
