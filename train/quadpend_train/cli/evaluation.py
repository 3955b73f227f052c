"""The command `evaluate`."""

import sys
from pathlib import Path

import tyro

from quadpend_train.cli.options import Episodes, Jobs, Latency, Seed, named_scenarios
from quadpend_train.evaluation.episodes import TEST_SEED

MORE = "rmse of survivors", "largest tilt", "effort", "action rate"  # columns that the files have and the terminal not


def evaluate(
    policies: tyro.conf.Positional[tuple[str, ...]] = ("adrc-paper", "adrc-matched"),
    scenarios: tuple[str, ...] = ("calm", "windy"),
    episodes: Episodes = 100,
    seed: Seed = TEST_SEED,
    out: Path = Path("results"),
    jobs: Jobs = 1,
    cache: Path = Path("results/cache"),
    vehicle: str | None = None,
    interface: str | None = None,
    autopilot: str | None = None,
    latency: Latency = None,
) -> None:
    """Evaluate policies in the same episodes and compare them with the first policy.

    The ranking puts survival first, then the error of the survivors in scenarios without events. A sentence for each
    policy says in which scenarios it beats the first one: by survival or, if that does not differ significantly, by the
    RMSE over the episodes that both survive. The level is 5 % after Holm's correction for the tests of a sentence.

    Args:
        policies: Classical controllers (adrc-paper, …), also with the gains of a file (lqg:gains.json), run folders,
            policy files (.npz, .zip), C files of export (c:policy.c, or supervised:policy.c with the supervisor), or
            module:factory, a function of your own that returns a controller. NAME=POLICY gives a policy a name;
            NAME=POLICY,POLICY,… combines the training seeds of one learner under a name.
        scenarios: Scenarios: names, TOML or JSON files, JSON, or module:factory, a function of your own that returns
            a wind or a Scenario. NAME=SCENARIO gives a scenario a name; "test" and "training" stand for all scenarios
            of these sets.
        episodes: Episodes in each scenario.
        seed: Seed of the first episode. Tuning uses seeds from 2000000, the selection of trained policies from 3000000.
        out: Folder for report.html and the tables (.csv, .md).
        jobs: Number of processes; the results do not depend on it.
        cache: Folder of cached results; only missing results are computed.
        vehicle: Vehicle of all scenarios: the name of a preset (quadpend list vehicles) or a TOML file. Forces of the
            wind are multiplied by the ratio of its weight to that of the scenario's vehicle, torques by the ratio of
            the torque limits; wind velocities stay.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
        autopilot: Real firmware in place of the rate loop in all scenarios, with gains matched to the vehicle, its own
            ones or those of a file of its command line: betaflight, betaflight:default or betaflight:tune.txt.
        latency: Latency in all scenarios, s: from an action to the moment when it acts.
    """
    from rich.console import Console

    from quadpend_train.reports import report, tables

    made = report.evaluate(
        policies,
        named_scenarios(scenarios, vehicle, interface, autopilot, latency),
        out,
        episodes=episodes,
        seed=seed,
        jobs=jobs,
        cache_folder=cache,
    )
    comparison = made.comparison
    console = Console(width=None if sys.stdout.isatty() else 150, emoji=False, markup=False, highlight=False)
    title = f"{episodes} episodes each, seeds from {seed}, 95 % intervals"
    rows = tables.with_margins(tables.metric_rows(comparison), comparison)
    console.print(tables.terminal_table(title, tables.without(rows, MORE)))
    if note := tables.episodes_note(comparison):
        console.print(note)
    for sentence in tables.sentences(comparison):
        console.print(f"• {sentence}")
    if len(comparison.policies) > 1:
        console.print(tables.terminal_table(tables.ranking_note(comparison), tables.ranking_rows(comparison)))
    console.print(f"Written: {out}/{', '.join(report.FILES)}; all metrics are in comparison.md")
