"""docs/flight/learning.csv, and its table in docs/flight-learning.md: the score over steps and seconds of training.

    python -m experiments.budgets                          # five training seeds in runs/budgets/; about six hours
    python -m experiments.budgets ppo-flight --minutes 1 --seeds 1      # a part; the other rows stay

A training has as many timesteps as fit into its budget on an idle machine; the seconds are measured. Processor seconds
include imitation and the score on the card, seconds do not. A finished training is found in its folder, and an
interrupted one goes on. Scores are those of the set `flight`: 50 episodes in each scenario, seeds from 1000000.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.pages import CACHE, DOCS, fill
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import compare
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.ranking import multiple, survivors
from quadpend_train.evaluation.table import cells
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import read_settings
from quadpend_train.training.train import train_or_resume

RUNS, FOLDER = Path("runs/budgets"), DOCS / "flight"
WIND = "flight_breeze", "flight_windy"  # the scenarios of fluctuating wind
STEPS = {  # factors on the timesteps of a preset, and of its imitation, for each budget in minutes
    "ppo-flight": {1: 1.0, 3: 3.0, 10: 10.0},
    "ppo-hummingbird": {1: 0.6, 3: 1.8, 10: 6.0},
    "sac-hummingbird": {1: 0.08, 3: 0.24, 10: 0.8},
}


def trained(preset: str, factor: float, seed: int, folder: Path) -> MlpPolicy:
    """Return the policy of a training, which is not repeated; its processor seconds are on the card."""
    settings, clock = read_settings(preset), folder / "processor_seconds.json"
    hybrid = replace(settings.hybrid, imitation_timesteps=round(factor * settings.hybrid.imitation_timesteps))
    steps = round(factor * settings.total_timesteps)
    if not (folder / "policy.npz").is_file():
        begin = time.process_time()
        train_or_resume(replace(settings, total_timesteps=steps, hybrid=hybrid, seed=seed), folder)
        write_text(clock, json.dumps(time.process_time() - begin))
    policy = MlpPolicy.load(folder / "policy.npz")
    policy.card["processor_seconds"] = json.loads(clock.read_text()) if clock.is_file() else float("nan")
    policy.card["steps"] += hybrid.imitation_timesteps
    return policy


def scored(name: str, minutes: int, seed: int, policy: MlpPolicy, episodes: int) -> dict[str, Any]:
    """Return a row of the table: survival (%) and multiple of the reference in the set, and in fluctuating wind."""
    found = compare({name: policy}, ["flight"], episodes, TEST_SEED, CACHE)
    row: dict[str, Any] = {"learner": name, "minutes": minutes, "seed": seed, "steps": policy.card["steps"]}
    row |= {key: policy.card[key] for key in ("seconds", "processor_seconds")}
    for label, names in {"": tuple(found.scenarios), "wind_": WIND}.items():
        values = {scenario: part for (scenario, _), part in cells(found.table).items() if scenario in names}
        errors = [survivors(values[scenario]) for scenario in names]
        survival = sum(found.summaries[scenario, name]["survival"].value for scenario in names) / len(names)
        row[label + "survival"] = survival
        row[label + "multiple"] = multiple(errors, [found.references[scenario] for scenario in names]).value
    return row


def page(table: pd.DataFrame) -> str:
    """Return the smallest value, the median and the largest value over the training seeds, in Markdown."""
    columns = [*table.columns[3:]]
    rows = []
    for (name, minutes), part in table.groupby(["learner", "minutes"]):
        texts = [" / ".join(map(format_number, part[item].quantile([0.0, 0.5, 1.0]))) for item in columns]
        rows.append([str(name), str(minutes), str(len(part)), *texts])
    return markdown_table(["learner", "budget (min)", "seeds", *(item.replace("_", " ") for item in columns)], rows)


def main() -> None:
    """Train, fly, and write the tables after each training."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("learners", nargs="*", default=[*STEPS])
    parser.add_argument("--minutes", type=int, nargs="*", default=[1, 3, 10], help="budgets")
    parser.add_argument("--seeds", type=int, default=5, help="number of training seeds")
    parser.add_argument("--episodes", type=int, default=50, help="episodes in each scenario")
    given, path = parser.parse_args(), FOLDER / "learning.csv"
    for minutes in given.minutes:
        for name in given.learners:
            for seed in range(given.seeds):
                policy = trained(name, STEPS[name][minutes], seed, RUNS / f"{name}-{minutes}-{seed}")
                new = pd.DataFrame([scored(name, minutes, seed, policy, given.episodes)])
                table = pd.concat([pd.read_csv(path), new]) if path.is_file() else new
                table = table.drop_duplicates(["learner", "minutes", "seed"], keep="last")
                table = table.sort_values(["learner", "minutes", "seed"])
                write_text(path, table.to_csv(index=False, float_format="%.5g", lineterminator="\n"))
                fill(DOCS / "flight-learning.md", {"budgets": page(table)})


if __name__ == "__main__":
    main()
