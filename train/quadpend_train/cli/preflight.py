"""The command `preflight`."""

import sys
from pathlib import Path

import tyro

from quadpend_train.cli.options import Episodes, Jobs, Seed, named_scenarios
from quadpend_train.evaluation.episodes import TEST_SEED


def preflight(
    policy: tyro.conf.Positional[str],
    vehicle: str | None = None,
    scenario: str = "flight_breeze",
    episodes: Episodes = 100,
    seed: Seed = TEST_SEED,
    jobs: Jobs = 2,
    cache: Path = Path("results/cache"),
) -> None:
    """Print the data sheet of a policy on a vehicle: its limits beside what flights need.

    It takes two to five minutes on two cores.

    The limit of an event, such as a jump of the set-point, is the largest strength that 99 % of the episodes survive. A
    bisection from the everyday strength finds it, as if a stronger event always felled more. Brackets are no confidence
    intervals: they have the largest tried strength without a fall and the smallest one at which survival is below 99 %
    with 95 % confidence. The room is the farthest distance from the reference at everyday strength.

    Args:
        policy: A policy, as in evaluate.
        vehicle: Vehicle in place of that of the scenario, as in evaluate. It keeps the loop of the scenario.
        scenario: Scenario with the vehicle and the loop as you fly them: interface, period, latency, sensors, and what
            else disturbs your flights. Events are added to it, in a hover.
        episodes: Episodes of each run, for each training seed of a learner; a limit takes about six runs.
        seed: Seed of the first episode.
        jobs: Number of processes; the results do not depend on it.
        cache: Folder of cached results; only missing results are computed.
    """
    from rich import box
    from rich.console import Console

    from quadpend_train.evaluation.preflight import data_sheet
    from quadpend_train.policies.loading import check_policy, load_policies
    from quadpend_train.reports.tables import terminal_table

    (name, flown), *others = named_scenarios((scenario,), vehicle).items()
    if others:
        raise ValueError(f"a data sheet is of one scenario: choose one of {', '.join([name, *dict(others)])}")
    policies = load_policies(policy)
    for each in policies:
        check_policy(policy, each, name, flown)
    sheet = data_sheet(policies, flown, episodes, seed, jobs, cache)
    console = Console(width=None if sys.stdout.isatty() else 150, emoji=False, markup=False, highlight=False)
    loop = f"{flown.interface} at {1.0 / flown.period:g} Hz, latency of {1e3 * flown.latency:g} ms"
    title = (
        f"{policy} on {flown.vehicle.name}, through the loop of {scenario} ({loop}; yours: --scenario FILE),"
        f" {episodes} episodes a run, seeds from {seed}"
    )
    table = terminal_table(title, sheet.table())
    table.box, table.show_edge = box.SIMPLE_HEAD, False
    console.print(table)
    for sentence in sheet.sentences():
        console.print(f"{sentence}.")
