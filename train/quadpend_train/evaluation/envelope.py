"""The envelope of a policy: the largest strength of each event that it survives.

The limit of an event is the largest strength at which at least `SURVIVAL` of the episodes survive. The strengths form a
grid, and a bisection finds the limit in about six runs of all episodes, as if survival never grew with the strength.
All runs have the same seeds, and the policy is designed for the everyday strength, or for no extra delay. The ends of
the interval of a limit are the largest tried strength below it without a fall, and the smallest tried one at which the
survival is below `SURVIVAL` with one-sided 95 % confidence (Clopper and Pearson).

    (1)  envelope = exp( mean over events of log(limit / everyday strength) )

`envelope.toml` has the events. Their grids are geometric and end at the highest strength of the file. A limit below the
lowest strength, an eighth of the everyday one, is 0, and counts as that one in (1).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Strict

from quadpend_baselines import Policy
from quadpend_gym.core.files import read_toml
from quadpend_gym.core.nested import changed, value_at
from quadpend_gym.core.settings import parse, settings
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.jobs import Job, run_job
from quadpend_train.evaluation.statistics import Interval, least_proportion

SURVIVAL = 0.99
EPISODES = 100  # of a run
BASE = "flight_breeze"  # the scenario in which nothing happens; events add to it
LOWEST, STEPS = 0.125, 8  # lowest strength as a share of the everyday one, and steps of a grid that double the strength
FILE = Path(__file__).with_suffix(".toml")
LONGEST, ENOUGH = 0.1, 0.015  # s: the longest extra delay, and that which a policy should tolerate


@settings
class _Event:
    """An event of the file."""

    scenario: str
    unit: str
    highest: float
    changes: dict[str, tuple[float, float]]
    commanded: Annotated[bool, Strict()] = False

    def at(self, strength: float) -> Scenario:
        """Return the scenario with another strength."""
        scenario, new = SCENARIOS[self.scenario], {}
        for path, (start, slope) in self.changes.items():
            value, old = start + slope * strength, value_at(scenario, path)
            new[path] = (value,) * len(old) if isinstance(old, tuple) else value
        made: Scenario = changed(scenario, new)
        return made

    @property
    def everyday(self) -> float:
        """The strength that the scenario has."""
        path, (start, slope) = next(iter(self.changes.items()))
        value = np.ravel(value_at(SCENARIOS[self.scenario], path))[0]
        return float((value - start) / slope)


@dataclass(frozen=True)
class Event:
    """Something that disturbs a flight with a strength."""

    unit: str
    everyday: float
    strengths: tuple[float, ...]  # that are searched, ascending
    at: Callable[[float], Scenario]
    known: Scenario  # for which policies are designed
    commanded: bool = False  # whether a pilot decides how strong it is


@cache
def _events(path: Path) -> dict[str, _Event]:
    return {name: parse(_Event, data, name) for name, data in read_toml(path).items()}


def events(base: Scenario, path: Path = FILE) -> dict[str, Event]:
    """Return the events of a file by name, on the vehicle of a scenario and through its loop, see `on`."""
    found = {}
    for name, event in _events(path).items():
        weights = base.vehicle.weight / SCENARIOS[event.scenario].vehicle.weight if event.unit == "mN" else 1.0
        everyday, doublings = event.everyday, np.log2(event.highest / (LOWEST * event.everyday))
        grid = LOWEST * everyday * 2.0 ** np.arange(0.0, doublings - 1e-9, 1.0 / STEPS)
        strengths, at = weights * np.append(grid, event.highest), partial(_at, event, base, weights)
        known = at(weights * everyday)
        found[name] = Event(event.unit, weights * everyday, tuple(strengths.tolist()), at, known, event.commanded)
    return found


def _at(event: _Event, base: Scenario, weights: float, strength: float) -> Scenario:
    return on(base, event.at(strength / weights))


def on(base: Scenario, event: Scenario) -> Scenario:
    """Return the scenario of an event with the vehicle and the loop of another scenario.

    What the event has in common with `BASE` is replaced by what the other scenario has: vehicle, interface, period,
    latency, observation, sensors and actuators, and the drawn loop and parameters if the event has none. The pole is
    told only if it is observed.
    """
    gentle, told = SCENARIOS[BASE], event.pole_told and "pole" in base.observation
    if base == gentle:
        return replace(event, pole_told=told)
    models: dict[str, Any] = {
        name: (*getattr(base, name), *(item for item in getattr(event, name) if item not in getattr(gentle, name)))
        for name in ("sensors", "actuators")
    }
    names = "latency", "period", "substeps", "observation", "autopilot", "loop_known"
    drawn = {name: getattr(event, name) or getattr(base, name) for name in ("loop", "parameters")}
    made = event.with_vehicle(base.vehicle, base.interface)
    return replace(made, pole_told=told, **{name: getattr(base, name) for name in names}, **models, **drawn)


def extra_delay(scenario: Scenario) -> Event:
    """Return the event that commands act later than a policy knows, in ms: whole substeps."""
    substep = 1000.0 * scenario.period / scenario.simulation.substeps
    strengths = tuple(substep * i for i in range(1, round(1000.0 * LONGEST / substep) + 1))
    return Event("ms", 1000.0 * ENOUGH, strengths, partial(_late, scenario), scenario)


def _late(scenario: Scenario, milliseconds: float) -> Scenario:
    late = 0.001 * milliseconds
    if scenario.loop and scenario.loop.latency:
        low, high = scenario.loop.latency
        return replace(scenario, loop=replace(scenario.loop, latency=(low + late, high + late)))
    return replace(scenario, latency=scenario.latency + late)


def limit(
    policies: Sequence[Policy],
    event: Event,
    episodes: int = EPISODES,
    seed: int = TEST_SEED,
    cache_folder: Path | None = None,
) -> Interval:
    """Return the limit of an event with its interval, in its unit.

    The policies are one controller, or the training seeds of one learner, which share the episodes of a run. The limit
    is the highest strength, and the upper end infinite, if all strengths are survived. A strength that is impossible on
    the vehicle is not survived.
    """
    each, survivals = max(episodes // len(policies), 1), {}
    tolerated, beyond = -1, len(event.strengths)
    while beyond - tolerated > 1:
        middle = (tolerated + beyond) // 2
        try:
            scenario = event.at(event.strengths[middle])
        except ValueError:  # such as a yaw rate above that of the vehicle
            beyond = middle
            continue
        job = Job([*policies], scenario, each, seed, known=event.known)
        survivals[middle] = run_job(job, cache_folder).survived
        if survivals[middle].mean() >= SURVIVAL:
            tolerated = middle
        else:
            beyond = middle
    without = [i for i, survived in survivals.items() if i <= tolerated and survived.all()]
    fewer = [i for i, survived in survivals.items() if least_proportion(~survived) > 1.0 - SURVIVAL]
    return Interval(
        event.strengths[tolerated] if tolerated >= 0 else 0.0,
        event.strengths[max(without)] if without else 0.0,
        event.strengths[min(fewer)] if fewer else np.inf,
    )


def limit_text(found: Interval, event: Event) -> str:
    """Return a limit with its interval; one at an end of the search is less than, or at least, that strength."""
    if found.value == 0.0:
        return f"< {format_number(event.strengths[0])}"
    most = f"≥ {format_number(found.value)}"
    return most if found.value == event.strengths[-1] else format_interval(found).replace("inf", "…")


def envelope(limits: Mapping[str, Interval], among: Mapping[str, Event]) -> Interval:
    """Return (1), in multiples of the everyday strengths, of the limits by the names of events."""
    low, high = np.array([[event.strengths[0], event.strengths[-1]] for event in among.values()]).T
    everyday = np.array([event.everyday for event in among.values()])
    ends = np.clip([limits[name] for name in among], low[:, np.newaxis], high[:, np.newaxis])
    return Interval(*np.exp(np.mean(np.log(ends / everyday[:, np.newaxis]), axis=0)).tolist())
