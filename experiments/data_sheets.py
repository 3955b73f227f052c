"""A table of docs/flight/tables.md: what data sheets say, flown again in other episodes.

    python -m experiments.data_sheets --jobs 2      # 200 episodes, seeds from 1000100; 15 minutes

The limits of `quadpend preflight` on two vehicles, and the survival at 0.9 and at 1.3 of each of them.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from experiments.pages import CACHE, DOCS, fill, made_by, options
from quadpend_baselines import Policy
from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.common.executors import run
from quadpend_train.evaluation.envelope import BASE, EPISODES, Event, events, limit
from quadpend_train.evaluation.formatting import format_interval, markdown_table
from quadpend_train.evaluation.jobs import Job, run_job
from quadpend_train.evaluation.statistics import proportion
from quadpend_train.policies.loading import load_policies

POLICIES, VEHICLES = ("lqg", "flatness", "dual-mode"), ("hummingbird", "racer")
SHARES = 0.9, 1.3


def check(policies: Sequence[Policy], event: Event, episodes: int, seed: int) -> list[str]:
    """Return the limit, and the survival in later episodes at shares of it; a dash where there is no such strength."""
    found = limit(policies, event, EPISODES, seed, CACHE)
    strengths, texts = np.array(event.strengths), [f"{found} {event.unit}"]
    for share in SHARES:
        strength = float(strengths[np.abs(strengths - share * found.value).argmin()])
        text = "–"
        if event.strengths[0] < share * found.value <= event.strengths[-1]:
            job = Job([*policies], event.at(strength), episodes, seed + EPISODES, known=event.known)
            text = format_interval(proportion(run_job(job, CACHE).survived).scaled(100.0))
        texts.append(text)
    return texts


def main() -> None:
    """Find the limits, fly at shares of them, and write the table."""
    given, calls = options(__doc__, 200), {}
    for vehicle in VEHICLES:
        base = SCENARIOS[BASE].with_vehicle(vehicle)
        for policy in POLICIES:
            for name, event in events(base).items():
                calls[vehicle, policy, name] = partial(check, load_policies(policy), event, given.episodes, given.seed)
    found = run(calls, given.jobs, what="limit")
    headings = ["vehicle", "policy", "event", "limit", *(f"survival at {share:g} of it (%)" for share in SHARES)]
    table = markdown_table(headings, [[*name, *found[name]] for name in calls])
    text = f"{made_by('data_sheets', given.episodes, given.seed + EPISODES)}\n\n{table}"
    fill(DOCS / "flight/tables.md", {"data-sheets": text})


if __name__ == "__main__":
    main()
