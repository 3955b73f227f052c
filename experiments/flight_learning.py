"""docs/learning/tables.md: what learning adds on the flight benchmark, and what it costs.

    python -m experiments.flight_learning --jobs 2      # 200 episodes in each scenario, seeds from 1000000

The training seeds of `apg-flight` and `ppo-flight` are compared with the classical controllers.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.pages import CACHE, DOCS, fill, made_by, options, training_seeds
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_interval, format_number, markdown_table
from quadpend_train.evaluation.metrics import cells
from quadpend_train.evaluation.pairwise import compare_pair, compare_pairs
from quadpend_train.evaluation.ranking import multiple, survivors
from quadpend_train.evaluation.statistics import mean
from quadpend_train.policies.loading import load_policies

LEARNERS, OPPONENT = ("apg-flight", "ppo-flight"), "lqg"  # the classical controller that ranks first in training-flight
CLASSICAL = "lqg", "dual-mode", "flatness", "adrc-matched", "lqi", "lqr"
SEEDS = 3
FEW = 50  # episodes of short trainings


def duel(found: Comparison) -> str:
    """Return survival and error of the learners and their opponent in each scenario, and who wins, in Markdown."""
    pairs, rows = [compare_pair(found.table, name, OPPONENT) for name in LEARNERS], []
    values = cells(found.table)
    for scenario in found.scenarios:
        row = [scenario.removeprefix("flight_")]
        for name in (OPPONENT, *LEARNERS):
            error = multiple([survivors(values[scenario, name])], [1.0]).value
            survival = found.summaries[scenario, name]["survival"].value
            row.append(format_number(1e3 * error) + ("" if survival == 100.0 else f", {survival:.4g} %"))
        rows.append([*row, *({1: "won", 0: "–", -1: "lost"}[pair.winners[scenario]] for pair in pairs)])
    headings = [
        "scenario",
        *(f"{name} (mm)" for name in (OPPONENT, *LEARNERS)),
        *(f"{name} against {OPPONENT}" for name in LEARNERS),
    ]
    return markdown_table(headings, rows) + "\n\n" + "\n".join(pair.sentence() for pair in pairs)


def budgets(found: Comparison) -> str:
    """Return survival, multiple and cost of trainings, in Markdown; the score is that of the flight benchmark."""
    rows, values = [], cells(found.table)
    for name, seeds in found.learners.items():
        cards: Sequence[Any] = [getattr(policy, "card", None) for policy in seeds]
        survival = found.table[found.table["policy"] == name].groupby("training_seed")["survived"].mean()
        errors = [survivors(values[scenario, name]) for scenario in found.scenarios]
        references = [found.references[scenario] for scenario in found.scenarios]
        each = [multiple([error[i : i + 1] for error in errors], references).value for i in range(len(seeds))]
        steps = cards[0]["steps"] + cards[0]["settings"]["hybrid"]["imitation_timesteps"]
        spread = [" / ".join(map(format_number, np.percentile(x, [0, 50, 100]))) for x in (100.0 * survival, each)]
        seconds = np.mean([card["seconds"] for card in cards])
        rows.append([name, str(len(seeds)), f"{steps:,}", f"{seconds:.0f}", *spread])
    headings = ["learner", "seeds", "timesteps", "seconds", "survival (%)", "multiple"]
    return markdown_table(headings, rows)


def memory(found: Comparison) -> str:
    """Return survival and error with a model mismatch, and their difference from `apg-flight`, in Markdown."""
    (scenario,), rows, values = found.scenarios, [], cells(found.table)
    pairs = compare_pairs(found.table, [(LEARNERS[0], name) for name in found.policies if name != LEARNERS[0]])
    for name in found.policies:
        error, row = multiple([survivors(values[scenario, name])], [1e-3]), ["–", "–"]
        if name != LEARNERS[0]:
            pair = pairs[LEARNERS[0], name]
            verdict = {1: "better", 0: "not distinguishable", -1: "worse"}[pair.winners[scenario]]
            row = [format_interval(mean(-pair.differences[scenario])), verdict]
        rows.append([name, format_interval(found.summaries[scenario, name]["survival"]), format_interval(error), *row])
    headings = ["policy", "survival (%)", "error (mm)", "penalised RMSE, difference (mm)", f"{LEARNERS[0]} is"]
    return markdown_table(headings, rows)


def main() -> None:
    """Fly, and write the tables of the page."""
    given = options(__doc__, 200)
    found: dict[str, Any] = {name: load_policies(training_seeds(name).rpartition("=")[2])[:SEEDS] for name in LEARNERS}
    common = given.episodes, given.seed, CACHE
    every = compare([OPPONENT, *map(training_seeds, LEARNERS)], ["flight"], *common, jobs=given.jobs)
    few = min(given.episodes, FEW), given.seed
    shorter = compare(found, ["flight"], *few, CACHE, jobs=given.jobs)
    late = compare(found | {name: name for name in CLASSICAL}, ["flight_unknown"], *common, jobs=given.jobs)
    head, head_of_few = (made_by("flight_learning", *each) for each in (common[:2], few))
    parts = {"duel": f"{head}\n\n{duel(every)}", "memory": f"{head}\n\n{memory(late)}"}
    fill(DOCS / "learning/tables.md", {**parts, "budgets": f"{head_of_few}\n\n{budgets(shorter)}"})


if __name__ == "__main__":
    main()
