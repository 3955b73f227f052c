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

from experiments.measures import call_time
from experiments.pages import CACHE, DOCS, README, fill, made_by, options, training_seeds
from quadpend_baselines.gains import tuned
from quadpend_gym.scenarios import SCENARIOS
from quadpend_train.common.executors import run
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.envelope import BASE, DELAY, EPISODES, Limit, envelope, events, limit
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.linear_models import reference
from quadpend_train.evaluation.metrics import cells
from quadpend_train.evaluation.ranking import gentle, multiple, survivors
from quadpend_train.reports import figures, tables

POLICIES = "lqg", "dual-mode", "flatness", "lqi", "adrc-matched", "adrc-paper", "apg-flight"
MARKERS = "os^vDP*X<>ph"
FEWER = "lqi", "adrc-matched", "adrc-paper"  # have no columns in the two largest tables of the page
FOLDER, ROWS = DOCS / "flight", 10  # rows of the table in the README
EVENTS = events(SCENARIOS[BASE])
SHORT = "rank", "policy", "survival bound (%)", "error (multiple of the reference)", "envelope", f"{DELAY} (ms)"
LONG = *SHORT, "delay margin (ms)", "effort", "call (µs)"  # columns of the page

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
    """Return the ranking with envelope, extra delay, smallest margin of the linear loops, and the time of a call."""
    headings, *rows = tables.ranking_rows(found)
    first, wide = next(iter(found.scenarios.values())), envelopes(limits)
    table = [[*headings, "envelope", f"{DELAY} (ms)", "delay margin (ms)", "call (µs)"]]
    for row in rows:
        policy = row[1]
        margins = [found.margins.get((scenario, policy)) for scenario in found.scenarios]
        margin = min((1000.0 * each.delay for each in margins if each), default=np.nan)
        call = 1e6 * call_time(found.learners[policy][0], first)
        numbers = str(limits[policy][DELAY]), format_number(margin), format_number(call)
        table.append([*row, str(wide[policy]), *numbers])
    return table


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


def matrix(table: pd.DataFrame, found: Comparison) -> str:
    """Return references and errors in mm, and survivals below 100 %, in Markdown, a line for each scenario."""
    rows, own = [], {name: reference(found.scenarios[name])[1] for name in found.references}
    for name, part in table[~table["policy"].isin(FEWER)].groupby("scenario", sort=False):
        row = [str(name).removeprefix("flight_")]
        row += [format_number(part["reference"].iloc[0]) + ("" if own[str(name)] else "*")]
        for cell in part.itertuples():
            text = format_number(cell.error)
            row.append(text if cell.survival == 100.0 else f"{text}, {cell.survival:.3g} %")
        rows.append(row)
    return markdown_table(["scenario", "reference", *(name for name in found.policies if name not in FEWER)], rows)


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
    axis.set(xlabel="envelope (multiple of everyday strengths)", ylabel="error (multiple of the linear reference)")
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
    axis.set(xlabel="error (multiple of the reference)", xscale="log")
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
    table, tried, rows = cell_table(found), limit_csv(limits), full_ranking(found, limits)
    columns, short = ([[row[rows[0].index(name)] for name in names] for row in rows] for names in (LONG, SHORT))
    parts = {
        "provenance": made_by("flight", *settings),
        "ranking": f"{markdown_table(columns[0], columns[1:])}\n\n{tables.ranking_note(found)}",
        "events": event_matrix(found),
        "limits": limit_table(tried),
        "matrix": matrix(table, found),
        "origins": origins(found),
    }
    for name, data in (("cells", table), ("limits", tried)):
        write_text(given.out / f"{name}.csv", data.to_csv(index=False, lineterminator="\n"))
    figures.write_png(front_figure(found, envelopes(limits)), given.out / "front.png")
    figures.write_png(scenario_figure(table), given.out / "scenarios.png")
    print(markdown_table(short[0], short[1 : ROWS + 1]))
    if given.out == FOLDER:
        fill(README, {"flight": markdown_table(short[0], short[1 : ROWS + 1])})
        fill(DOCS / "flight.md", {f"flight-{name}": text for name, text in parts.items()})
    else:
        write_text(given.out / "tables.md", "\n\n".join(parts.values()) + "\n")


if __name__ == "__main__":
    main()
