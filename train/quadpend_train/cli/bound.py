"""The command `quadpend bound`: an optimal flight of each episode, known in advance, and the gap of policies to it.

The parameters of the function are the options of the command. Slow imports are inside it, so that `quadpend --help`
starts quickly.
"""

import json
import shlex
from pathlib import Path

import tyro

from quadpend_train.cli.options import Episodes, Seed, make_console, named_policies, named_scenarios
from quadpend_train.common.executors import executor
from quadpend_train.common.files import writable_folder, write_text
from quadpend_train.evaluation.cache import FOLDER, check_folder
from quadpend_train.evaluation.episodes import VALIDATION_SEED

PART = "bound"  # of a document


def bound(
    policies: tyro.conf.Positional[tuple[str, ...]] = ("flatness",),
    scenarios: tuple[str, ...] = ("calm", "windy"),
    episodes: Episodes = 20,
    seed: Seed = VALIDATION_SEED,
    out: Path = Path("results/bound"),
    jobs: int = 1,
    cluster: str | None = None,
    cache: str = FOLDER,
    recompute: bool = False,
    document: Path | None = None,
) -> None:
    """Plan the best flight of each episode, with all wind known in advance, and measure the gap of policies to it.

    The flight is a local optimum, so its error estimates the least possible error from above. Needs the extra mpc. An
    episode takes 10 to 25 s of processor time. Scenarios with rigid vehicles, or with actuators
    other than delays and lags, are left out.

    Args:
        policies: Policies, as in evaluate; the gap that others close is measured from that of flatness.
        scenarios: Scenarios, as in evaluate.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Seeds from 1000000 are used for the published results, from 2000000 for tuning.
        out: Folder for bound.csv (one line for each episode), bound.md (the table), bound.json (its numbers) and
            bound.png. Episodes in bound.csv are not planned again.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that runs the jobs instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        cache: Folder or URL (s3://…) of cached results of the policies; only missing results are computed.
        recompute: Plan all episodes again, also those in bound.csv.
        document: Markdown file in which to update the part "bound".
    """
    from quadpend_gym.scenarios import find_scenario
    from quadpend_train.common import documents
    from quadpend_train.common.provenance import provenance
    from quadpend_train.evaluation.comparison import compare
    from quadpend_train.reports import figures
    from quadpend_train.studies import bound as study

    run = executor(jobs, cluster)
    if document:
        documents.check(document, [PART])
    chosen = {name: find_scenario(value) for name, value in named_scenarios(scenarios).items()}
    reasons = {name: reason for name, scenario in chosen.items() if (reason := study.left_out(scenario))}
    chosen = {name: scenario for name, scenario in chosen.items() if name not in reasons}
    notes = [f"{name} is left out: {reason}." for name, reason in reasons.items()]
    if not chosen:
        raise ValueError(f"no scenario can be planned: {' '.join(notes)}")
    check_folder(cache)
    writable_folder(out)
    comparison = compare(named_policies(policies), chosen, episodes, seed, cache, jobs=run)
    found = study.plan(chosen, episodes, seed, out, run, recompute)
    measured = study.gaps(found, comparison)
    table = "\n\n".join([study.markdown(found, measured), *notes])
    made = provenance()
    data = {"provenance": made, "episodes": episodes, "seed": seed, "results": study.as_data(found, measured)}
    write_text(out / "bound.json", json.dumps(data, indent=1, allow_nan=False) + "\n")
    shown = {scenario: {name: gap.gap for name, gap in row.items()} for scenario, row in measured.items()}
    label = "penalised RMSE minus that of the best flight that was found (mm)"
    figures.write_png(figures.interval_figure(shown, label, log=True), out / "bound.png")
    write_text(out / "bound.md", table + "\n")
    if document:
        command = f"`{shlex.join(made['command'])}`: {episodes} episodes in each scenario, seeds from {seed}."
        documents.fill(document, {PART: f"{command}\n\n{table}"})
    make_console().print(table, highlight=False, markup=False)
    print(f"Written: {out}/bound.csv, bound.md, bound.json, bound.png")
