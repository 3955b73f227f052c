"""The commands that write pages of results: `vehicles` for docs/vehicles-results.md, `tasks` for docs/tasks-results.md.

The parameters of the functions are the options of the commands. Slow imports are inside them, so that `quadpend --help`
starts quickly.
"""

import json
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import tyro

from quadpend_baselines import CONTROLLERS
from quadpend_gym.core.validation import suggest
from quadpend_gym.vehicles import VEHICLES
from quadpend_train.common.executors import executor
from quadpend_train.common.files import to_json_data, writable_folder, write_text
from quadpend_train.evaluation.cache import FOLDER, check_folder
from quadpend_train.evaluation.episodes import VALIDATION_SEED

PARTS = ("presets", "recovery", "as-flown", "leaderboard")


def vehicles(
    policies: tyro.conf.Positional[tuple[str, ...]] = ("flatness", "lqr", "lqi", "mppi", "adrc-matched"),
    parts: tuple[str, ...] = PARTS,
    presets: tuple[str, ...] = tuple(VEHICLES),
    episodes: int = 200,
    seed: int = VALIDATION_SEED,
    out: Path = Path("results/vehicles"),
    jobs: int = 1,
    cluster: str | None = None,
    cache: str = FOLDER,
    document: Path | None = None,
) -> None:
    """Measure how well policies fly real vehicles: in wind, from large tilts, and as flown in an experiment.

    Args:
        policies: Classical controllers, and for the leaderboard also other policies, as in evaluate.
        parts: Parts of the study: presets (every vehicle in calm air and in wind), recovery (the largest tilts),
            as-flown (the experiment, with and without prediction over its latency), leaderboard (the set
            test-hummingbird).
        presets: Vehicles of the parts presets and recovery.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Seeds from 1000000 are used for the published results, from 2000000 for tuning.
        out: Folder for a table PART.md and its numbers PART.json of each part.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that runs the jobs instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        cache: Folder or URL (s3://…) of cached results; only missing results are computed.
        document: Markdown file in which to update the generated parts vehicles-PART; other text does not change.
    """
    from quadpend_train.common import documents
    from quadpend_train.common.provenance import provenance
    from quadpend_train.studies import vehicles as study

    for given, known, noun in ((parts, PARTS, "part"), (presets, tuple(VEHICLES), "vehicle")):
        _check_names(given, known, noun)
    controllers = [name for name in policies if name in CONTROLLERS]
    if not controllers and set(parts) != {"leaderboard"}:
        raise ValueError(
            f"policies must have a classical controller for the parts other than leaderboard, not {policies}"
        )
    run = executor(jobs, cluster)
    if document:
        documents.check(document, [f"vehicles-{part}" for part in parts])
    check_folder(cache)
    writable_folder(out)
    settings: dict[str, Any] = {"cache_folder": cache, "processes": run}
    measure: dict[str, Callable[[], study.Table]] = {
        "presets": partial(study.measure_presets, controllers, presets, episodes, seed, **settings),
        "recovery": partial(study.measure_recovery, controllers, presets, seed, **settings),
        "as-flown": partial(study.measure_as_flown, controllers, episodes, seed, **settings),
        "leaderboard": partial(_leaderboard, policies, episodes, seed, cache, run),
    }
    for part in parts:
        table = measure[part]()
        write_text(out / f"{part}.md", table.markdown + "\n")
        data = {"provenance": provenance(), "episodes": episodes, "seed": seed, "results": table.data}
        write_text(out / f"{part}.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
        if document:
            documents.fill(document, {f"vehicles-{part}": table.markdown})
        print(f"{part}:\n{table.markdown}\n", flush=True)
    print(f"Written: {out}/{', '.join(f'{part}.md, {part}.json' for part in parts)}")


def _leaderboard(policies: tuple[str, ...], episodes: int, seed: int, cache: str, run: Executor) -> Any:
    """Return leaderboard and penalised RMSE of the scenarios of the set test-hummingbird."""
    from quadpend_train.cli.options import named_policies, named_scenarios
    from quadpend_train.evaluation.comparison import compare
    from quadpend_train.evaluation.leaderboard import leaderboard
    from quadpend_train.reports import tables
    from quadpend_train.studies.vehicles import Table

    chosen = named_scenarios(("test-hummingbird",))
    comparison = compare(named_policies(policies), chosen, episodes, seed, cache, jobs=run)
    parts = [tables.leaderboard_markdown(leaderboard(comparison)), tables.matrix_markdown(comparison)]
    return Table("\n\n".join(parts), comparison.as_data()["results"])


def tasks(
    part: tyro.conf.Positional[str],
    policies: tyro.conf.Positional[tuple[str, ...]] = (),
    episodes: int = 200,
    seed: int = VALIDATION_SEED,
    out: Path = Path("results/tasks"),
    jobs: int = 1,
    cluster: str | None = None,
    cache: str = FOLDER,
    document: Path | None = None,
) -> None:
    """Measure how well policies swing the pendulum up, carry a load, recover, or follow fast references.

    Args:
        part: Part of the study: swing-up, load, recovery or agile.
        policies: Policies, as in evaluate; the default are those of docs/tasks-results.md.
        episodes: Episodes in each scenario, and at each acceleration of the part agile.
        seed: Seed of the first episode. Seeds from 1000000 are used for the published results, from 2000000 for tuning.
        out: Folder for a table PART.md and its numbers PART.json, and for agile.png.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that runs the jobs instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        cache: Folder or URL (s3://…) of cached results; only missing results are computed.
        document: Markdown file in which to update the generated part tasks-PART; other text does not change.
    """
    from quadpend_train.cli.options import named_policies, named_scenarios
    from quadpend_train.common import documents
    from quadpend_train.evaluation.comparison import compare
    from quadpend_train.reports import figures, robustness_plots
    from quadpend_train.studies import tasks as study

    _check_names((part,), tuple(study.PARTS), "part")
    run = executor(jobs, cluster)
    if document:
        documents.check(document, [f"tasks-{part}"])
    check_folder(cache)
    writable_folder(out)
    named = named_policies(policies or study.PARTS[part].policies)
    chosen = named_scenarios((study.PARTS[part].scenarios,))
    comparison = compare(named, chosen, episodes, seed, cache, jobs=run)
    measured = study.measure(comparison, part)
    results = {
        scenario: {policy: to_json_data(measured[scenario, policy]) for policy in comparison.policies}
        for scenario in comparison.scenarios
    }
    data: dict[str, Any] = {**comparison.provenance(), "results": results}
    text, files = study.table(measured, part), [f"{part}.md", f"{part}.json"]
    if part == "agile":
        found = study.measure_acceleration(named, episodes, seed, cache_folder=cache, jobs=run)
        feasible = [study.feasible_shares(value, episodes, seed) for value in study.ACCELERATION.values]
        text += "\n\n" + study.acceleration_table(found, feasible)
        data["acceleration"] = {
            **found.as_data()["axes"]["acceleration"],
            "feasible": [shares._asdict() for shares in feasible],
        }
        limits = {
            "references with thrust within limits": [shares.thrust for shares in feasible],
            "references with torques within limits": [shares.torques for shares in feasible],
        }
        figure = robustness_plots.axis_figure(found, "acceleration", limits)
        figures.write_png(figure, out / "agile.png")
        files.append("agile.png")
    write_text(out / f"{part}.md", text + "\n")
    write_text(out / f"{part}.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
    if document:
        documents.fill(document, {f"tasks-{part}": text})
    print(f"{text}\n\nWritten: {out}/{', '.join(files)}")


def _check_names(names: tuple[str, ...], known: tuple[str, ...], noun: str) -> None:
    if not names:
        raise ValueError(f"{noun}s must be at least one of {', '.join(known)}")
    for name in names:
        if name not in known:
            raise ValueError(f"there is no {noun} {name!r}{suggest(name, known)}; there are {', '.join(known)}")
