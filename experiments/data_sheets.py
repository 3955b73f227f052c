"""docs/flight/data_sheets.csv: what data sheets say, flown again in other episodes, and its summary in docs/flight.md.

    python -m experiments.data_sheets --jobs 2      # 200 episodes, seeds from 1000100; 15 minutes

The limits of `quadpend preflight` on two vehicles, and the survival at 0.9 and at 1.3 of each of them.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.pages import CACHE, DOCS, fill, made_by, options
from quadpend_baselines import Policy
from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.common.executors import run
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.envelope import BASE, EPISODES, Event, events, limit
from quadpend_train.evaluation.jobs import Job, run_job
from quadpend_train.policies.loading import load_policies

POLICIES, VEHICLES = ("lqg", "flatness", "dual-mode"), ("hummingbird", "racer")
SHARES = 0.9, 1.3


def check(policies: Sequence[Policy], event: Event, episodes: int, seed: int) -> list[Any]:
    """Return unit and limit, and the survival (%) in later episodes at shares of it; nan if they are out of range."""
    found = limit(policies, event, EPISODES, seed, CACHE)
    strengths, survivals = np.array(event.strengths), [np.nan] * len(SHARES)
    for i, share in enumerate(SHARES):
        strength = float(strengths[np.abs(strengths - share * found.value).argmin()])
        if event.strengths[0] < share * found.value <= event.strengths[-1]:
            job = Job([*policies], event.at(strength), episodes, seed + EPISODES, known=event.known)
            survivals[i] = 100.0 * run_job(job, CACHE).survived.mean()
    return [event.unit, found.value, *survivals]


def main() -> None:
    """Find the limits, fly at shares of them, and write the table and its summary."""
    given, calls = options(__doc__, 200), {}
    for vehicle in VEHICLES:
        base = SCENARIOS[BASE].with_vehicle(vehicle)
        for policy in POLICIES:
            for name, event in events(base).items():
                calls[vehicle, policy, name] = partial(check, load_policies(policy), event, given.episodes, given.seed)
    found = run(calls, given.jobs, what="limit")
    columns = ["vehicle", "policy", "event", "unit", "limit", *(f"survival at {share:g}" for share in SHARES)]
    table = pd.DataFrame([[*name, *found[name]] for name in calls], columns=columns)
    write_text(DOCS / "flight/data_sheets.csv", table.to_csv(index=False, lineterminator="\n"))
    fill(DOCS / "flight.md", {"data-sheets": summary(table, given.episodes, given.seed + EPISODES)})


def summary(table: pd.DataFrame, episodes: int, seed: int) -> str:
    """Return the ranges of survival of each vehicle."""
    lines = []
    for vehicle, part in table.groupby("vehicle", sort=False):
        columns = [part[f"survival at {share:g}"] for share in SHARES]
        ranges = (
            f"{each.min():g} to {each.max():g} % at {share:g}" for share, each in zip(SHARES, columns, strict=True)
        )
        lines.append(f"- `{vehicle}`, {len(part)} limits: survival of {' and '.join(ranges)} of the limit.")
    return f"{made_by('data_sheets', episodes, seed)}\n\n" + "\n".join(lines)


if __name__ == "__main__":
    main()
