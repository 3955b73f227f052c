"""docs/one-policy.md and docs/one-policy/unseen.csv: one network for every vehicle, beside lqg and others.

    python -m experiments.one_policy --jobs 2      # 100 episodes in each scenario, seeds from 1000000

The networks of `dagger-vehicles` (imitation) and `apg-vehicles-safe`, which two trainings lead to from it, are told
nothing but the measurements; `lqg` knows every vehicle. The networks for one vehicle have the settings of the first two
trainings with one vehicle, a quarter of the labels and 2,000,000 steps. They are trained once, in runs/one-policy/.
"""

from pathlib import Path
from typing import Any

import pandas as pd

from experiments.pages import CACHE, DOCS, POLICIES, fill, made_by, options, with_survival
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.vehicles import VEHICLES
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.formatting import markdown_table
from quadpend_train.training.settings import read_settings, with_values
from quadpend_train.training.train import resume, train

RUNS = Path("runs/one-policy")
FIRST, SECOND = (str(POLICIES / f"{name}-vehicles-0.npz") for name in ("dagger", "apg"))
KNOWN = tuple(name for name, vehicle in VEHICLES.items() if vehicle.attitude == "rigid")
UNSEEN = tuple(f"random:{seed}" for seed in range(1001, 1021))
OWN = "hummingbird", "skydio-x2", "racer"  # vehicles with a network of their own
AIR = {"calm": "vehicles_calm", "wind": "vehicles_windy"}


def own_policy(vehicle: str) -> str:
    """Return the path of the network that is trained for one vehicle only."""
    first, folder = RUNS / f"{vehicle}-imitation", RUNS / f"{vehicle}-apg"
    windy, calm = f"vehicles_training@{vehicle}", f"vehicles_training_calm@{vehicle}"
    labels = {"hybrid.imitation_timesteps": 1_000_000, "hybrid.imitation_rounds": 10}
    steps = {"total_timesteps": 2_000_000, "num_envs": 64, "start_from": str(first)}
    for path, policy, values in (
        (first, FIRST, {"scenarios": (windy,), **labels}),
        (folder, SECOND, {"scenarios": (windy, calm), **steps}),
    ):
        if not (path / "policy.npz").is_file():
            settings = with_values(read_settings(policy), values)
            resume(path, settings) if (path / "settings.json").is_file() else train(settings, path)
    return str(folder)


def flown(vehicle: str, names: list[str], given: Any) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the summaries of policies by air and name."""
    scenarios = {air: found for air, name in AIR.items() for found in find_scenarios(f"{name}@{vehicle}").values()}
    made = compare(names, scenarios, given.episodes, given.seed, CACHE, jobs=given.jobs)
    return {air: {name: made.summaries[air, name] for name in made.policies} for air in AIR}


def error(cell: dict[str, Any]) -> float:
    """Return the settled error, mm."""
    return float(cell["settled_rmse"].value)


def main() -> None:
    """Train what is missing, fly, and fill the tables."""
    given = options(__doc__, episodes=100)
    names = ["lqg", "one=apg-vehicles-safe-0"]
    rows, others = [], []
    for vehicle in KNOWN:
        own = [f"own={own_policy(vehicle)}"] if vehicle in OWN else []
        for air, cells in flown(vehicle, names + own, given).items():
            ratio = f"{error(cells['one']) / error(cells['own']):.2f}" if own else ""
            numbers = [with_survival(f"{error(cell):.3g}", cell) for cell in cells.values()]
            rows.append([vehicle, air, *numbers, *([] if own else [""]), ratio])
    for vehicle in UNSEEN:
        for air, cells in flown(vehicle, names, given).items():
            others += [
                (vehicle, air, name, cell["survival"].value, round(error(cell), 2)) for name, cell in cells.items()
            ]
    headings = ["vehicle", "air", "lqg", "one network", "network of its own", "one / own"]
    head = made_by("one_policy", given.episodes, given.seed)
    fill(DOCS / "one-policy.md", {"vehicles": f"{head}\n\n{markdown_table(headings, rows)}"})
    unseen = pd.DataFrame(others, columns=["vehicle", "air", "policy", "survival (%)", "error (mm)"])
    write_text(DOCS / "one-policy/unseen.csv", unseen.to_csv(index=False, lineterminator="\n"))


if __name__ == "__main__":
    main()
