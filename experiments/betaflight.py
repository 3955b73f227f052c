"""docs/betaflight.md: policies through real firmware, with gains matched to the vehicle and with its own.

    python -m experiments.betaflight      # 20 episodes in each scenario, seeds from 1000000; or with other policies

The scenarios are `flight_breeze`, a fluctuating force of 0.12 N on the hummingbird, and the same at 50 Hz with 30 ms of
latency; the racer flies them with forces in proportion to its weight. It needs the firmware of Betaflight.
"""

from dataclasses import replace

from experiments.pages import CACHE, DOCS, fill, made_by, options, with_survival
from quadpend_gym.autopilots import Betaflight
from quadpend_gym.autopilots.firmware import find_binary
from quadpend_gym.scenarios import SCENARIOS, Scenario
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.formatting import markdown_table

POLICIES = "lqg", "flatness", "lqr", "dual-mode", "apg-flight-0", "apg-loops-0"
VEHICLES = "hummingbird", "racer"
LOOPS = {"own loop": None, "matched": Betaflight("matched"), "default": Betaflight("default")}
BREEZE = SCENARIOS["flight_breeze"]
KINDS = {"wind": BREEZE, "50 Hz, 30 ms": replace(BREEZE, period=0.02, substeps=8, latency=0.03)}


def scenarios() -> dict[str, Scenario]:
    """Return the scenarios by vehicle, kind and loop, in the order of the rows."""
    return {
        " · ".join((vehicle, kind, loop)): replace(
            scenario if vehicle == "hummingbird" else scenario.with_vehicle(vehicle), autopilot=autopilot
        )
        for vehicle in VEHICLES
        for kind, scenario in KINDS.items()
        for loop, autopilot in LOOPS.items()
    }


def main() -> None:
    """Fly, and fill the table."""
    given = options(__doc__, 20, POLICIES)
    try:
        find_binary(Betaflight().binary)
    except OSError as error:
        print(f"Skipped: {error}.")
        return
    made = compare(given.policies, scenarios(), given.episodes, given.seed, CACHE, jobs=given.jobs)
    rows = []
    for name in made.scenarios:
        cells = [made.summaries[name, policy] for policy in made.policies]
        numbers = [with_survival(f"{cell['settled_rmse'].value:.3g}", cell) for cell in cells]
        rows.append([*name.split(" · "), *numbers])
    table = markdown_table(["vehicle", "scenario", "rate loop", *made.policies], rows)
    fill(DOCS / "betaflight.md", {"betaflight": f"{made_by('betaflight', given.episodes, given.seed)}\n\n{table}"})


if __name__ == "__main__":
    main()
