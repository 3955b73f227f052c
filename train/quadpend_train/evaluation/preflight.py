"""The data sheet of a policy on a vehicle: what a lab reads before a flight.

It has the margins of the linear model, the survival and the error in a scenario, and the limit of each event beside its
everyday strength, see `quadpend_train.evaluation.envelope`. Advice counts a limit up to the lower end of its bracket.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from quadpend_baselines import Policy
from quadpend_gym.scenarios import Scenario
from quadpend_gym.vehicles.plausibility import LATE, LEAST_THRUST, delays
from quadpend_train.common.executors import run
from quadpend_train.evaluation.envelope import DELAY, EPISODES, SURVIVAL, TOLERATED, Event, Limit, events, limit
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.formatting import format_interval, format_number
from quadpend_train.evaluation.jobs import Job, run_job
from quadpend_train.evaluation.linear_models import loop_margins
from quadpend_train.evaluation.metrics import summarise, values_of

FIRST = 0.5  # share of a limit up to which the first flights go
MEASURED = {DELAY: "latency", "pole not as believed": "pole", "loss of thrust": "thrust"}  # by what believes it
CAUGHT = "held pole let go"
DRAGGED = (
    "While a hand holds the pole, here for 3 s, a policy drags the vehicle along: try flatness or dual-mode, which do"
    " least, and hold it for less than a second"
)
HEADINGS = ("", "found", "needed", "found / needed", "room (m)")
NOTE = (
    "Brackets, no confidence intervals: largest tried strength without a fall, smallest one beyond"
    f" {SURVIVAL:.0%} with 95 % confidence. Room: largest error"
)


@dataclass(frozen=True)
class DataSheet:
    """The limits of a policy, and what else a lab reads before a flight.

    `rows` has what was found, what is needed, the ratio, 1 or more if it suffices, and the room (m, nan: not known), of
    everything but the limits.
    """

    rows: list[tuple[str, str, str, float, float]]
    events: dict[str, Event]
    limits: dict[str, Limit]

    def table(self) -> list[Sequence[str]]:
        """Return the headings and all rows as text."""
        lines = list(self.rows)
        for name, event in self.events.items():
            found, needed = self.limits[name], f"{format_number(event.everyday)} {event.unit}"
            lines.append((name, f"{found} {event.unit}", needed, found.value / event.everyday, found.room))
        return [HEADINGS, *((*texts, format_number(ratio), format_number(room)) for *texts, ratio, room in lines)]

    def sentences(self) -> list[str]:
        """Return what is not enough, and what to fly first."""
        ratios = {name: self.limits[name].clean / event.everyday for name, event in self.events.items()}
        short = [name for name, _, _, ratio, _ in self.rows if ratio < 1.0]
        weak = [name for name, ratio in ratios.items() if ratio < 1.0]
        out = [NOTE, *(f"Warning: not enough {name}" for name in short)]
        halves = {name: f"{format_number(FIRST * self.limits[name].clean)} {self.events[name].unit}" for name in ratios}
        if weak:
            out.append(f"Warning: not shown to survive everyday strength: {', '.join(weak)}")
        failed = [name for name in weak if self.limits[name].value < self.events[name].everyday]
        out += [DRAGGED] * (CAUGHT in failed)
        if short or any(not self.events[name].commanded for name in failed):  # what no pilot can leave out
            return [*out, "Fly first: nothing; mend what is not enough, or take another policy"]
        reserves = [f"{name} ({ratio:.2g} times)" for ratio, name in sorted((x, name) for name, x in ratios.items())]
        steps = [
            f"{name} {format_number(min(FIRST * self.limits[name].clean, event.everyday))} {event.unit}"
            for name, event in self.events.items()
            if event.commanded and name not in weak
        ]
        return [
            *out,
            f"Smallest reserves: {', '.join(reserves[len(weak) :][:3])}",
            f"Measure before: {', '.join(f'{what} within {halves[name]}' for name, what in MEASURED.items())}",
            f"Fly first: on the desk; tethered, the pole let go within {halves[CAUGHT]} of upright, with"
            f" {format_number(self.limits[CAUGHT].room)} m of room; hover in still air; then {', '.join(steps)}",
        ]


def data_sheet(
    policies: Sequence[Policy],
    scenario: Scenario,
    episodes: int = EPISODES,
    seed: int = TEST_SEED,
    jobs: int = 1,
    cache_folder: Path | None = None,
) -> DataSheet:
    """Return the data sheet of one controller, or of the training seeds of one learner, on the vehicle of a scenario.

    The events happen on the vehicle and through the loop of the scenario, see `quadpend_train.evaluation.envelope.on`.
    """
    found = events(scenario)
    calls = {name: partial(limit, policies, event, episodes, seed, cache_folder) for name, event in found.items()}
    limits = run(calls, jobs, what="limit")
    flown = run_job(Job([*policies], scenario, episodes, seed), cache_folder)
    summary = summarise(values_of(flown))
    simulation, vehicle = scenario.simulation, scenario.vehicle
    late, fall = sum(delays(simulation).values()), vehicle.stiffness**-0.5
    survival = summary["survival"]
    rows = [
        (
            f"survival in {scenario.name}",
            f"{format_interval(survival)} %",
            f"{SURVIVAL:.0%}",
            survival.value / (100.0 * SURVIVAL),
            float(np.nanmax(flown.error)),
        ),
        (
            "time of the pole (1/√K) over delays",
            f"{1e3 * fall:.0f} / {1e3 * late:.0f} ms",
            f"{1.0 / LATE:g}",
            LATE * fall / late if late else np.inf,
            np.nan,
        ),
    ]
    if vehicle.rotors:
        thrust = 4.0 * vehicle.rotors.thrust[1] / vehicle.weight
        rows.append(("largest thrust", f"{thrust:.2f} weights", f"{LEAST_THRUST:g}", thrust / LEAST_THRUST, np.nan))
    for margins in loop_margins({"": [*policies]}, {"": scenario}).values():
        text = f"{1e3 * margins.delay:.1f} ms (phase {np.rad2deg(margins.phase):.0f}°)"
        rows.append(("delay margin, linear model", text, f"{1e3 * TOLERATED:g} ms", margins.delay / TOLERATED, np.nan))
    return DataSheet(rows, found, limits)
