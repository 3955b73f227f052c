"""docs/flight.md with docs/flight/, and the table of the README: the flight benchmark.

    python -m experiments.flight --jobs 2      # 200 episodes in each scenario, seeds from 1000000
    python -m experiments.flight lqg flatness mine=mine:make --out results/flight      # with a policy of yours

It needs the extras mpc and control. What is finished is kept in results/cache, and the same command continues.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from experiments.pages import CACHE, DOCS, README, fill, made_by, options, training_seeds
from quadpend_baselines.gains import tuned
from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.common.executors import run
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.envelope import BASE, DELAY, EPISODES, Limit, envelope, events, limit
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.metrics import cells
from quadpend_train.evaluation.ranking import gentle, multiple, survivors
from quadpend_train.reports import figures, tables

POLICIES = "lqg", "lab", "dual-mode", "flatness", "lqi", "adrc-matched", "adrc-paper", "apg-flight"
MARKERS = "os^vDP*X<>ph"
FEWER = "lqi", "adrc-matched", "adrc-paper"  # have no columns in the table of limits
FOLDER, ROWS = DOCS / "flight", 10  # rows of the table in the README
EVENTS = events(SCENARIOS[BASE])
ERROR = "error (multiple of the linear reference)"
COLUMNS = "rank", "policy", "survival bound (%)", ERROR, "envelope", f"{DELAY} (ms)"

Limits = Mapping[str, Mapping[str, Limit]]  # by the names of policies and of events


def find_limits(found: Comparison, episodes: int, seed: int, jobs: int) -> Limits:
    """Return the limit of each event for each policy."""
    calls = {
        (policy, name): partial(limit, seeds, event, episodes, seed, CACHE)
        for policy, seeds in found.learners.items()
        for name, event in EVENTS.items()
    }
    limits = run(calls, jobs, what="limit")
    return {policy: {name: limits[policy, name] for name in EVENTS} for policy in found.policies}


def envelopes(limits: Limits) -> dict[str, Limit]:
    """Return the envelope of each policy."""
    return {policy: envelope(each, EVENTS) for policy, each in limits.items()}


def full_ranking(found: Comparison, limits: Limits) -> list[list[str]]:
    """Return the ranking with envelope and extra delay."""
    headings, *rows = tables.ranking_rows(found)
    wide, headings = envelopes(limits), [*headings, "envelope", f"{DELAY} (ms)"]
    rows = [[*row, str(wide[row[1]]), str(limits[row[1]][DELAY])] for row in rows]
    return [[row[headings.index(name)] for name in COLUMNS] for row in (headings, *rows)]


def errors_of(found: Comparison, policy: str) -> list[Any]:
    """Return the errors of a policy in each gentle scenario, m, shape (s, n), nan for falls."""
    values = cells(found.table)
    return [survivors(values[scenario, policy]) for scenario in gentle(list(found.scenarios))]


def cell_table(found: Comparison) -> pd.DataFrame:
    """Return survival (%), reference and error of the survivors (mm), and the multiple with its interval."""
    rows = []
    for policy in found.policies:
        for (scenario, length), error in zip(found.references.items(), errors_of(found, policy), strict=True):
            share, ratio = 100.0 * np.mean(~np.isnan(error)), multiple([error], [length])
            rows.append((scenario, policy, share, 1e3 * length, 1e3 * length * ratio.value, *ratio))
    columns = ["scenario", "policy", "survival", "reference", "error", "multiple", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def event_matrix(found: Comparison) -> str:
    """Return survivals in % in Markdown, a line for each event at everyday strength in which a policy falls."""
    rows, names = [], sorted(found.scenarios.keys() - {*gentle(list(found.scenarios))})
    for name in names:
        shares = [found.summaries[name, policy]["survival"].value for policy in found.policies]
        if min(shares) < 100.0:
            rows.append([name, *(f"{share:.3g}" for share in shares)])
    table, others = markdown_table(["event", *found.policies], rows), len(names) - len(rows)
    return f"{table}\n\nIn the {others} other events every policy survives all episodes."


def limit_csv(limits: Limits) -> pd.DataFrame:
    """Return the limits with what was tried: ``clean`` and ``failed`` are those of `Limit`."""
    rows = [
        (name, event.unit, event.everyday, policy, *each[name][:4])
        for policy, each in limits.items()
        for name, event in EVENTS.items()
    ]
    return pd.DataFrame(rows, columns=["event", "unit", "everyday", "policy", "limit", "clean", "failed", "sign"])


def limit_table(table: pd.DataFrame) -> str:
    """Return the limits in Markdown, a line for each event."""
    rows, shown = [], table[~table["policy"].isin(FEWER)]
    for (name, unit, everyday), part in shown.groupby(["event", "unit", "everyday"], sort=False):
        texts = (f"{cell.sign} {format_number(cell.limit)}".strip() for cell in part.itertuples())
        rows.append([f"{name} ({unit})", format_number(everyday), *texts])
    return markdown_table(["event", "everyday", *dict.fromkeys(shown["policy"])], rows)


def origins(found: Comparison) -> str:
    """Return sentences on how each policy was made, with percentiles of the error over the training seeds."""
    made: dict[str, list[str]] = {}  # names by sentence
    for policy, seeds in found.learners.items():
        cards: list[Any] = [getattr(item, "card", None) for item in seeds]
        card, search = cards[0], tuned("hummingbird").get(policy)
        text = f"`{search.command.replace(f' {policy} ', ' NAME ')}`" if search else "by hand"
        if card:
            script, seconds = card.get("script"), np.mean([item["seconds"] for item in cards])
            scenarios = (script or card["settings"])["scenarios"]
            names = [f"`{item if isinstance(item, str) else item['name']}`" for item in scenarios]
            where = f"{len(names)} scenarios of `{script['file']}`" if script else ", ".join(names)
            text = f"{card['steps']:,} steps and {seconds:.0f} s in {where}"
        if len(seeds) > 1:
            lengths = list(found.references.values())
            errors = errors_of(found, policy)
            each = [multiple([error[i : i + 1] for error in errors], lengths).value for i in range(len(seeds))]
            spread = " / ".join(map(format_number, np.percentile(each, [10.0, 50.0, 90.0])))
            text += f"; {len(seeds)} training seeds, whose multiples have the 10 / 50 / 90 % points {spread}"
        made.setdefault(text, []).append(f"`{policy}`")
    return "\n".join(f"- {', '.join(names)}: {text}." for text, names in made.items())


def front_figure(found: Comparison, wide: Mapping[str, Limit]) -> Any:
    """Return the figure of precision against envelope; the symbols of policies without a rank are empty.

    Bars are the intervals of the error and the brackets of the envelope.
    """
    figure = figures.new_figure(7.5, 4.4)
    ((axis,),) = figures.add_axes(figure, 1, 1)
    for row in sorted(found.ranking, key=lambda row: found.policies.index(row.policy)):
        i, x, y = found.policies.index(row.policy), wide[row.policy], row.multiple
        bars = {f"{name}err": np.abs([[end - each.value] for end in each[1:3]]) for name, each in (("x", x), ("y", y))}
        colour = figures.colour(i)
        face = colour if row.has_rank else "white"
        axis.errorbar(x.value, y.value, **bars, fmt=MARKERS[i], color=colour, mfc=face, label=row.policy)
    axis.set(xlabel="envelope (multiple of everyday strengths)", ylabel=ERROR)
    axis.set(xscale="log", yscale="log")
    figures.set_log_ticks(axis.xaxis, (1.0, 2.0, 5.0))
    return _finish(figure, axis, axis.yaxis)


def scenario_figure(table: pd.DataFrame) -> Any:
    """Return the figure of the multiples in each scenario; symbols are empty where survival is below 99 %."""
    figure = figures.new_figure(7.5, 6.0)
    ((axis,),) = figures.add_axes(figure, 1, 1)
    for i, (name, part) in enumerate(table.groupby("policy", sort=False)):
        faces = [figures.colour(i) if share >= 99.0 else "white" for share in part["survival"]]
        style = {"marker": MARKERS[i], "edgecolors": figures.colour(i), "zorder": 3}
        axis.scatter(part["multiple"], range(len(part)), c=faces, **style)
        axis.scatter([], [], c=figures.colour(i), label=name, **style)
    axis.set_yticks(range(len(part)), part["scenario"].str.removeprefix("flight_"))
    axis.invert_yaxis()
    axis.set(xlabel=ERROR, xscale="log")
    return _finish(figure, axis, axis.xaxis)


def _finish(figure: Any, axis: Any, scale: Any) -> Any:
    """Add grid, ticks of a logarithmic scale, and legend."""
    figures.set_log_ticks(scale, (1.0, 2.0, 5.0))
    axis.grid(color="#dddddd", linewidth=0.5)
    figure.legend(loc="outside right center", frameon=False)
    return figure


def main() -> None:
    """Fly, and write the page with its figures and tables."""
    given = options(__doc__, 200, POLICIES, FOLDER)
    settings = given.episodes, given.seed
    found = compare([*map(training_seeds, given.policies)], ["flight", "events"], *settings, CACHE, jobs=given.jobs)
    limits = find_limits(found, min(given.episodes, EPISODES), given.seed, given.jobs)
    table, tried, ranking = cell_table(found), limit_csv(limits), full_ranking(found, limits)
    parts = {
        "provenance": made_by("flight", *settings),
        "ranking": f"{markdown_table(ranking[0], ranking[1:])}\n\n{tables.ranking_note(found)}",
        "events": event_matrix(found),
        "limits": limit_table(tried),
        "origins": origins(found),
    }
    for name, data in (("cells", table), ("limits", tried)):
        write_text(given.out / f"{name}.csv", data.to_csv(index=False, lineterminator="\n"))
    figures.write_png(front_figure(found, envelopes(limits)), given.out / "front.png")
    figures.write_png(scenario_figure(table), given.out / "scenarios.png")
    best = markdown_table(ranking[0], ranking[1 : ROWS + 1])
    print(best)
    if given.out == FOLDER:
        fill(README, {"flight": best})
        fill(DOCS / "flight.md", {f"flight-{name}": text for name, text in parts.items()})
    else:
        write_text(given.out / "tables.md", "\n\n".join(parts.values()) + "\n")


if __name__ == "__main__":
    main()
