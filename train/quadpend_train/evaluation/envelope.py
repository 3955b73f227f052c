"""The envelope of a policy: the largest strength of each event that it survives.

The limit of an event is the largest strength at which at least `SURVIVAL` of the episodes survive. The strengths form a
grid. A bisection that begins at the everyday strength finds the limit in about six runs of all episodes, as if a
stronger event always felled more. All runs have the same seeds, and the policy is designed for the everyday strength,
or for no extra delay. Every training seed of a learner flies all episodes, and they are pooled: the limit is that of
the mean survival of these seeds. A run ends early once it has `enough` falls.

The bracket of a limit (`Limit`) tells what was seen, and is no confidence interval: its ends are the largest tried
strength up to the limit without a fall, and the smallest tried one beyond it at which the survival is below `SURVIVAL`
with one-sided 95 % confidence. That is Clopper and Pearson's test, in which the seeds of a learner count as one: they
fly the same episodes.

    (1)  envelope = exp( mean over events of log(limit / everyday strength) )

`envelope.toml` has the events of (1). Their grids are geometric and end at the highest strength of the file. A limit
below the lowest strength, an eighth of the everyday one, counts as that one, and one beyond the grid as the highest;
the sign of a limit and of (1) says so.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from quadpend_baselines import Policy
from quadpend_gym.core.files import read_toml
from quadpend_gym.core.nested import changed, value_at
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.formatting import format_number
from quadpend_train.evaluation.jobs import Job, run_job
from quadpend_train.evaluation.statistics import CONFIDENCE

SURVIVAL = 0.99
EPISODES = 100  # of a run, for each training seed
BASE = "flight_breeze"  # the scenario in which nothing happens; events add to it
LOWEST, STEPS = 0.125, 8  # lowest strength as a share of the everyday one, and steps of a grid that double the strength
FILE = Path(__file__).with_suffix(".toml")
DELAY = "extra delay"  # the event that is no part of (1)
LONGEST, TOLERATED = 0.1, 0.015  # s: the longest extra delay, and that which a policy should tolerate


class Limit(NamedTuple):
    """The limit of an event or the envelope, with its bracket, which is no confidence interval."""

    value: float
    clean: float  # largest tried strength up to the limit without a fall; 0: none
    failed: float  # smallest tried strength that is certainly beyond the limit; infinite: none
    sign: str = ""  # "≥" and "<" where the search ended at the end of its grid; the envelope has "≈" if both occur
    room: float = np.nan  # farthest distance from the reference at everyday strength, m; nan if too many fell

    def __str__(self) -> str:
        """Return the limit with its bracket, such as ``≥ 8.00 (8.00, –)``."""
        ends = [self.clean or np.nan, self.failed if self.failed < np.inf else np.nan]
        value, clean, failed = (format_number(number, np.nanmin([self.value, *ends])) for number in (self.value, *ends))
        return f"{self.sign} {value} ({clean}, {failed})".strip()


@dataclass(frozen=True)
class Event:
    """Something that disturbs a flight with a strength."""

    unit: str
    everyday: float
    strengths: tuple[float, ...]  # that are searched, ascending; the smallest one from the everyday one on is the first
    at: Callable[[float], Scenario]
    known: Scenario  # for which policies are designed
    commanded: bool = False  # whether a pilot decides how strong it is


def events(base: Scenario, path: Path = FILE) -> dict[str, Event]:
    """Return the events of a file and the extra delay by name, on the vehicle of a scenario and through its loop."""
    return {name: _event(base, **table) for name, table in read_toml(path).items()} | {DELAY: _extra_delay(base)}


def _event(
    base: Scenario,
    scenario: str,
    unit: str,
    highest: float,
    changes: Mapping[str, tuple[float, float]],
    commanded: bool = False,
) -> Event:
    """Return an event from its table in the file; forces are relative to the weight of the vehicle."""
    own = SCENARIOS[scenario]
    weights = base.vehicle.weight / own.vehicle.weight if unit == "mN" else 1.0

    def at(strength: float) -> Scenario:
        new = {}
        for path, (start, slope) in changes.items():
            value, old = start + slope * strength / weights, value_at(own, path)
            new[path] = (value,) * len(old) if isinstance(old, tuple) else value
        return on(base, changed(own, new))

    path, (start, slope) = next(iter(changes.items()))
    everyday = (float(np.ravel(value_at(own, path))[0]) - start) / slope
    grid = LOWEST * everyday * 2.0 ** np.arange(0.0, np.log2(highest / (LOWEST * everyday)) - 1e-9, 1.0 / STEPS)
    strengths = weights * np.append(grid, highest)
    return Event(unit, weights * everyday, tuple(strengths.tolist()), at, at(weights * everyday), commanded)


def _extra_delay(base: Scenario) -> Event:
    """Return the event that commands act later than a policy knows, in ms: whole substeps."""
    substep = 1000.0 * base.period / base.simulation.substeps
    strengths = tuple(substep * i for i in range(1, round(1000.0 * LONGEST / substep) + 1))

    def at(milliseconds: float) -> Scenario:
        late = 0.001 * milliseconds
        if base.loop and base.loop.latency:
            low, high = base.loop.latency
            return replace(base, loop=replace(base.loop, latency=(low + late, high + late)))
        return replace(base, latency=base.latency + late)

    return Event("ms", 1000.0 * TOLERATED, strengths, at, base)


def on(base: Scenario, event: Scenario) -> Scenario:
    """Return another scenario with what the scenario of an event adds to `BASE`, on the vehicle of the other one.

    Every field that the event has in common with `BASE` is that of the other scenario. Models of wind, sensors and
    actuators that `BASE` does not have are appended, also a light fluctuating force beside another wind. Where both
    scenarios differ from `BASE`, loop and parameters are merged field by field, and the event decides about a single
    number or interval: a parameter of the vehicle has one interval, and numbers of a loop change at one time. The task
    is that of the event, a hover from rest: only there are a hand beside the reference and a start defined. An event
    that draws parameters of the pole also decides whether the pole is told, if it is observed.
    """
    gentle = SCENARIOS[BASE]
    if (base.vehicle, base.interface) != (gentle.vehicle, gentle.interface):
        gentle, event = (one.with_vehicle(base.vehicle, base.interface) for one in (gentle, event))
    if base.parameters and event.parameters:
        nominal = base.simulation.parameters
        base = replace(base, parameters=base.parameters.ranges(nominal))
        event = replace(event, parameters=event.parameters.ranges(nominal))
    made: Scenario = _merged(replace(base, task=event.task), gentle, event)
    told = (event if event.parameters else base).pole_told and "pole" in base.observation
    return replace(made, pole_told=told, name=event.name)


def _merged(base: Any, gentle: Any, event: Any) -> Any:
    """Return the value of a field, see `on`; where `BASE` has no such part, its values are the default ones."""
    if event == gentle:
        return base
    if base == gentle:
        return event
    if isinstance(event, tuple) and all(map(is_dataclass, event)):  # models
        return (*base, *(model for model in event if model not in gentle))
    if not is_dataclass(event) or type(event) is not type(base):
        return event
    values: dict[str, Any] = {
        part.name: _merged(
            getattr(base, part.name), getattr(gentle, part.name, part.default), getattr(event, part.name)
        )
        for part in fields(event)
    }
    made: Any = base
    return replace(made, **values)


def limit(
    policies: Sequence[Policy],
    event: Event,
    episodes: int = EPISODES,
    seed: int = TEST_SEED,
    cache_folder: Path | None = None,
) -> Limit:
    """Return the limit of an event in its unit.

    The policies are one controller, or the training seeds of one learner, each of which flies all episodes. A strength
    that is impossible on the vehicle is not survived.
    """
    allowed = (1.0 - SURVIVAL) * episodes * len(policies)
    enough = len(policies) * (1 + int(stats.binom.isf(1.0 - CONFIDENCE, episodes, 1.0 - SURVIVAL)))
    falls: dict[int, int] = {}
    room, tolerated, beyond = np.nan, -1, len(event.strengths)
    tried = first = min(int(np.searchsorted(event.strengths, event.everyday * (1.0 - 1e-9))), beyond - 1)
    while beyond - tolerated > 1:
        try:
            scenario = event.at(event.strengths[tried])
        except ValueError:  # such as a yaw rate above that of the vehicle
            falls[tried] = enough
        else:
            job = Job([*policies], scenario, episodes, seed, known=event.known, enough=enough)
            flown = run_job(job, cache_folder)
            falls[tried] = int(np.count_nonzero(flown.cause))
            if tried == first and falls[tried] < enough:
                room = float(np.nanmax(flown.error))
        if falls[tried] <= allowed:
            tolerated = tried
        else:
            beyond = tried
        tried = (tolerated + beyond) // 2
    clean = [i for i, number in falls.items() if i <= tolerated and not number]
    failed = [i for i, number in falls.items() if number >= enough]
    return Limit(
        event.strengths[max(tolerated, 0)],
        event.strengths[max(clean)] if clean else 0.0,
        event.strengths[min(failed)] if failed else np.inf,
        "<" if tolerated < 0 else "≥" if beyond == len(event.strengths) else "",
        room,
    )


def envelope(limits: Mapping[str, Limit], among: Mapping[str, Event]) -> Limit:
    """Return (1), in multiples of the everyday strengths, of the limits by the names of events."""
    counted = {name: event for name, event in among.items() if name != DELAY}
    low, high = np.array([[event.strengths[0], event.strengths[-1]] for event in counted.values()]).T
    everyday = np.array([event.everyday for event in counted.values()])
    ends = np.clip([limits[name][:3] for name in counted], low[:, np.newaxis], high[:, np.newaxis])
    signs = {limits[name].sign for name in counted} - {""}
    value, clean, failed = np.exp(np.mean(np.log(ends / everyday[:, np.newaxis]), axis=0)).tolist()
    return Limit(value, clean, failed, "≈" if len(signs) > 1 else "".join(signs))
