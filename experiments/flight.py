"""docs/flight.md, docs/flight/ and the first table of the README: the flight benchmark.

    python -m experiments.flight --jobs 2      # 200 episodes in each scenario, seeds from 1000000
    python -m experiments.flight lqg flatness mine=mine:make --out results/flight      # with a policy of yours

It needs the extras mpc and control. docs/flight/lqg_front.csv, a curve in a figure, comes from `experiments.lqg_front`.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.flight_cells import cell_table, errors_of, front_figure, scenario_figure
from experiments.measures import call_time, delay_budget, recovery
from experiments.pages import CACHE, DOCS, README, fill, made_by, options, training_seeds
from quadpend_baselines.gains import tuned
from quadpend_gym.scenarios import SCENARIOS, find_scenarios
from quadpend_train.common.executors import run
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_interval, format_number, markdown_table
from quadpend_train.evaluation.jobs import Job, run_jobs
from quadpend_train.evaluation.linear_models import reference
from quadpend_train.evaluation.ranking import multiple
from quadpend_train.evaluation.statistics import Interval
from quadpend_train.reports import figures, tables

POLICIES = (
    *("lqg", "flatness", "dual-mode", "lqi", "lqr", "adrc-matched", "adrc-paper"),
    *("apg-flight", "ppo-flight"),
)
SLOW, SLOW_EPISODES = ("nmpc",), 20  # takes long, and flies in these scenarios only
SLOW_SCENARIOS = (
    *("flight_breeze", "flight_dryden_medium", "flight_gusts", "flight_late", "flight_masses", "flight_circle"),
)
FOLDER = DOCS / "flight"
BREEZE, BLOCK = "flight_breeze", 100  # scenario of the delay margins, and episodes of each search


def delay_margins(found: Comparison, seed: int, jobs: int) -> dict[str, Interval]:
    """Return the median, smallest and largest delay budget, s, of three blocks of episodes or of all training seeds."""
    calls = {
        (name, i): partial(delay_budget, seeds[i % len(seeds)], SCENARIOS[BREEZE], BLOCK, seed + BLOCK * i)
        for name, seeds in found.learners.items()
        for i in range(max(3, len(seeds)))
    }
    budgets = run(calls, jobs, what="delay budget")
    values = {name: [budget for (policy, _), budget in budgets.items() if policy == name] for name in found.learners}
    return {name: Interval(float(np.median(each)), min(each), max(each)) for name, each in values.items()}


def ranking_with_costs(found: Comparison) -> list[list[str]]:
    """Return the ranking with the time of a call in the first scenario, and the smallest margin of the linear loops."""
    headings, *rows = tables.ranking_rows(found)
    table, first = [[*headings, "call (µs)", "delay margin (ms)"]], next(iter(found.scenarios.values()))
    for row in rows:
        margins = [found.margins.get((scenario, row[1])) for scenario in found.scenarios]
        margin = min((1000.0 * each.delay for each in margins if each), default=np.nan)
        call = 1e6 * call_time(found.learners[row[1]][0], first)
        table.append([*row, format_number(call), format_number(margin)])
    return table


def matrix(table: pd.DataFrame, found: Comparison) -> str:
    """Return errors in mm with their multiples, and survivals below 100 %, in Markdown, a line for each scenario."""
    rows, own = [], {name: reference(scenario)[1] for name, scenario in found.scenarios.items()}
    for name, part in table.groupby("scenario", sort=False):
        row = [str(name), format_number(part["reference"].iloc[0]) + ("" if own[str(name)] else " *")]
        for cell in part.itertuples():
            text = f"{format_number(cell.error)} ({format_number(cell.multiple)})"
            row.append(text if cell.survival == 100.0 else f"{text}, {cell.survival:.3g} %")
        rows.append(row)
    return markdown_table(["scenario", "reference", *found.policies], rows)


def origins(found: Comparison) -> str:
    """Return in Markdown how each policy was made, and percentiles of the error over its training seeds."""
    rows, limits = [], list(found.references.values())
    for policy, seeds in found.learners.items():
        cards: list[Any] = [getattr(item, "card", None) for item in seeds]
        card, search, spread = cards[0], tuned("hummingbird").get(policy), "–"
        texts = [", ".join(search.scenarios), f"`{search.command}`"] if search else ["–", "set by hand"]
        if card:
            names = [item if isinstance(item, str) else item["name"] for item in card["settings"]["scenarios"]]
            seconds = np.mean([item["seconds"] for item in cards])
            texts = [", ".join(names), f"{card['steps']:,} steps, {seconds:.0f} s"]
        if len(seeds) > 1:
            errors = errors_of(found, policy)
            each = [multiple([error[i : i + 1] for error in errors], limits).value for i in range(len(seeds))]
            spread = " / ".join(map(format_number, np.percentile(each, [10.0, 50.0, 90.0])))
        rows.append([policy, *texts, str(len(seeds)), spread])
    headings = ["policy", "training set", "budget", "seeds", "multiple, 10 / 50 / 90 % of seeds"]
    return markdown_table(headings, rows)


def recovery_table(found: Comparison, episodes: int, seed: int, jobs: int) -> str:
    """Return the shares of recovered episodes and their mean times in Markdown."""
    scenarios, rows = find_scenarios("recovery-flight"), {policy: [policy] for policy in found.policies}
    wanted = {(s, p): Job(found.learners[p], scenarios[s], episodes, seed) for p in rows for s in scenarios}
    for (name, policy), results in run_jobs(wanted, CACHE, jobs).items():
        share, seconds = recovery(results, scenarios[name].period)
        rows[policy].append(f"{format_interval(share)}, {format_number(seconds.value)} s")
    return markdown_table(["policy", *(name.removeprefix("flight_recovery_") for name in scenarios)], rows.values())


def onset_table(found: Comparison, episodes: int, seed: int, jobs: int) -> str:
    """Return the survival in turbulence that rises and in turbulence that begins at once, in Markdown."""
    sudden = compare(found.learners, ["flight_onset"], episodes, seed, CACHE, jobs=jobs).summaries
    scenarios = ["dryden_severe_fair", "dryden_severe"]
    fair, severe = compare(["flatness"], scenarios, episodes, seed, CACHE, jobs=jobs).summaries.values()
    pairs = [(p, found.summaries["flight_dryden_fast", p], sudden["flight_onset", p]) for p in found.policies]
    pairs.append(("flatness, paper's vehicle", fair, severe))
    rows = [[policy, *(format_interval(item["survival"]) for item in both)] for policy, *both in pairs]
    return markdown_table(["policy", "fair start: survival (%)", "sudden wind: survival (%)"], rows)


def slow_table(found: Comparison, seed: int, jobs: int) -> str:
    """Return the table with the policies that take long, in the few episodes that they fly, in Markdown."""
    slow = compare(SLOW, SLOW_SCENARIOS, SLOW_EPISODES, seed, CACHE, jobs=jobs)
    same = (found.table["episode"] < SLOW_EPISODES) & found.table["scenario"].isin(SLOW_SCENARIOS)
    every, learners = pd.concat([found.table[same], slow.table]), found.learners | slow.learners
    both = replace(slow, table=every, learners=learners, margins=found.margins | slow.margins)
    headings, *rows = ranking_with_costs(both)
    return markdown_table(headings[1:], [row[1:] for row in rows])  # too few episodes for a rank


def main() -> None:
    """Fly, and write the page with its figures and tables."""
    given = options(__doc__, 200, POLICIES, FOLDER)
    settings, page, published = (given.episodes, given.seed), given.out / "tables.md", FOLDER / "tables.md"
    found = compare([*map(training_seeds, given.policies)], ["flight"], *settings, CACHE, jobs=given.jobs)
    delays, table = delay_margins(found, given.seed, given.jobs), cell_table(found)
    rows = [[*row, "extra delay (ms)"] for row in ranking_with_costs(found)]
    for row in rows[1:]:
        row[-1] = format_interval(delays[row[1]].scaled(1e3))
    parts = {
        "provenance": made_by("flight", *settings),
        "ranking": markdown_table(rows[0], rows[1:]),
        "origins": origins(found),
        "matrix": matrix(table, found),
        "recovery": recovery_table(found, *settings, given.jobs),
        "onset": onset_table(found, *settings, given.jobs),
    }
    write_text(given.out / "cells.csv", table.to_csv(index=False, lineterminator="\n"))
    figures.write_png(front_figure(table[table["scenario"] == BREEZE], delays), given.out / "front.png")
    figures.write_png(scenario_figure(table), given.out / "scenarios.png")
    if page == published:
        parts["slow"] = slow_table(found, given.seed, given.jobs)
        shown = rows[:5] + [row for row in rows[5:] if row[1] == "adrc-paper"]
        short = [[row[i] for i in (0, 1, 2, 4, -1, -3)] for row in shown]  # survival, error, extra delay, call
        fill(README, {"flight": markdown_table(short[0], short[1:])})
        fill(DOCS / "flight.md", {f"flight-{name}": parts[name] for name in ("provenance", "ranking")})
    write_text(page, published.read_text(encoding="utf-8"))
    fill(page, {f"flight-{name}": text for name, text in parts.items()})


if __name__ == "__main__":
    main()
