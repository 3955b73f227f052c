"""The commands that evaluate policies: `evaluate` and `compare`.

The parameters of these functions are the options of the commands. Slow imports are inside the functions, so that
`quadpend --help` starts quickly.
"""

from pathlib import Path
from typing import Annotated

import tyro

from quadpend_gym.core.settings import Range
from quadpend_train.cli.options import Episodes, Seed, make_console, named_policies, named_scenarios
from quadpend_train.common.executors import executor
from quadpend_train.evaluation.cache import FOLDER, check_folder
from quadpend_train.evaluation.episodes import VALIDATION_SEED

_MOST_SENTENCES, _MOST_ROWS = 16, 40  # largest numbers that are printed; the files contain all of them


def evaluate(
    policies: tyro.conf.Positional[tuple[str, ...]] = ("adrc-paper", "adrc-matched"),
    scenarios: tuple[str, ...] = ("calm", "windy"),
    episodes: Episodes = 100,
    seed: Seed = VALIDATION_SEED,
    out: Path = Path("results"),
    jobs: int = 1,
    cluster: str | None = None,
    cache: str = FOLDER,
    recompute: bool = False,
    robustness: Annotated[int, Range(0, 100_000)] = 0,
    replay: Annotated[int, Range(0, 1000)] = 2,
    document: Path | None = None,
    vehicle: str | None = None,
    interface: str | None = None,
    bound: Path | None = None,
) -> None:
    """Evaluate policies in the same episodes and compare them with the first policy.

    Args:
        policies: Classical controllers (adrc-paper, …), run folders, policy files (.npz, .zip), or
            module:factory, a function of your own that returns a controller. NAME=POLICY gives a policy a name;
            NAME=POLICY,POLICY,… combines the training seeds of one learner under a name.
        scenarios: Scenarios: names, TOML or JSON files, JSON, or module:factory, a function of your own that returns
            a wind or a Scenario. NAME=SCENARIO gives a scenario a name; "test" and "training" stand for all scenarios
            of these sets.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Seeds from 1000000 are used for the published results, from 2000000 for tuning.
        out: Folder for report.html, comparison.json, .csv, .md and .png, and figures of robustness.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that runs the jobs instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        cache: Folder or URL (s3://…) of cached results; only missing results are computed.
        recompute: Compute all results again, also cached ones.
        robustness: Episodes at each value of the perturbation axes, see train/quadpend_train/studies; 0 omits the
            robustness curves and the recovery maps. Vehicle, control period and duration are those of the first
            scenario. Of a learner with several training seeds, the first is evaluated.
        replay: Episodes of each scenario that the report can replay; 0 omits the replay.
        document: Markdown file in which to update the generated parts.
        vehicle: Vehicle of all scenarios: the name of a preset (quadpend list vehicles) or a TOML file. Forces of the
            wind are multiplied by the ratio of its weight to that of the scenario's vehicle, torques by the ratio of
            the torque limits; wind velocities stay.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
        bound: The file bound.csv of quadpend bound with the same scenarios and seeds: the leaderboard on the terminal
            and in the document gets a row of the best flights that were found with the wind known in advance. It is
            estimated from fewer episodes, with the best policy as control variate.
    """
    from quadpend_train.common import documents
    from quadpend_train.evaluation import bound as bounds
    from quadpend_train.reports import report, results, tables

    chosen = named_scenarios(scenarios, vehicle, interface)
    planned = bounds.by_scenario(bounds.read_bound(bound), list(chosen), seed, episodes) if bound else None
    if document:
        documents.check(document, results.PARTS)
    made = report.evaluate(
        named_policies(policies),
        chosen,
        out,
        episodes=episodes,
        seed=seed,
        jobs=executor(jobs, cluster),
        cache_folder=cache,
        recompute=recompute,
        robustness=robustness,
        replay=replay,
    )
    comparison, standings = made.comparison, made.leaderboard
    best = bounds.bound_row(planned, comparison, standings[0].policy) if planned else None
    if document:
        results.update_document(comparison, standings, made.robustness, document, best)
    console = make_console()
    if len(comparison.results) <= _MOST_ROWS:
        console.print(tables.comparison_table(comparison))
    for note in tables.notes(comparison):
        console.print(note, highlight=False)
    if len(sentences := tables.verdicts(comparison)) <= _MOST_SENTENCES:
        for sentence in sentences:
            console.print(f"• {sentence}", highlight=False)
    if len(comparison.policies) > 1:
        console.print(tables.leaderboard_table(standings, best))
        if note := tables.leaderboard_note(comparison):
            console.print(note, highlight=False)
    console.print(f"Written: {out}/{', '.join(made.files)}", highlight=False)


def compare(
    policies: tyro.conf.Positional[tuple[str, str]],
    scenarios: tuple[str, ...] = ("test",),
    episodes: Episodes = 200,
    seed: Seed = VALIDATION_SEED,
    jobs: int = 1,
    cluster: str | None = None,
    cache: str = FOLDER,
    recompute: bool = False,
    vehicle: str | None = None,
    interface: str | None = None,
) -> None:
    """Compare two policies: print in which scenarios each of them wins, by how much, and how certain that is.

    A policy wins a scenario if its survival is significantly higher. If survival does not differ significantly, the
    policy with the significantly smaller RMSE wins, over the episodes that both survive. The level is 5 % after Holm's
    correction for the number of tests.

    Args:
        policies: Two policies, as in evaluate.
        scenarios: Scenarios, as in evaluate.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Seeds from 1000000 are used for the published results, from 2000000 for tuning.
        jobs: Number of processes; the results do not depend on it.
        cluster: Ray cluster that runs the jobs instead: auto, local, ray://HOST:PORT or HOST:PORT. It needs Ray.
        cache: Folder or URL (s3://…) of cached results; only missing results are computed.
        recompute: Compute all results again, also cached ones.
        vehicle: Vehicle of all scenarios: the name of a preset (quadpend list vehicles) or a TOML file. Forces of the
            wind are multiplied by the ratio of its weight to that of the scenario's vehicle, torques by the ratio of
            the torque limits; wind velocities stay.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
    """
    from quadpend_train.evaluation.comparison import compare as compare_policies
    from quadpend_train.evaluation.pairwise import compare_pair
    from quadpend_train.reports import tables

    run = executor(jobs, cluster)
    check_folder(cache)
    named, chosen = named_policies(policies), named_scenarios(scenarios, vehicle, interface)
    comparison = compare_policies(named, chosen, episodes, seed, cache, recompute, run)
    pair = compare_pair(comparison, *named)
    console = make_console()
    console.print(pair.sentence(), highlight=False)
    console.print(tables.pairwise_table(pair))
    for note in tables.notes(comparison):
        console.print(note, highlight=False)
