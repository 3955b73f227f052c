"""docs/results.md: learned policies and classical controllers in all test scenarios.

    python -m experiments.results --jobs 2      # 200 episodes in each scenario, seeds from 1000000; half an hour

It also writes docs/results/comparison.csv and report.html; `python -m experiments.samples` makes sample.csv there.
"""

import shutil

from experiments.pages import CACHE, DOCS, fill, made_by, options, training_seeds, with_survival
from quadpend_baselines.gains import tuned
from quadpend_train.evaluation.comparison import Comparison, compare
from quadpend_train.evaluation.formatting import format_number, markdown_table
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.reports import report, tables

LEARNED = ("apg", "ppo-alone", "sac-alone")
CLASSICAL = (*("dual-mode", "flatness", "lqi", "lqr", "adrc-matched", "adrc-tuned", "adrc-linear", "adrc-paper"),)

SHOWN = (*LEARNED[:2], *CLASSICAL[:3], "adrc-matched", "adrc-linear", "adrc-paper")  # in the table of scenarios
PAIRS = 3  # pairwise comparisons on the page, of the best policy with the next ones


def matrix(comparison: Comparison) -> str:
    """Return a Markdown table of the penalised RMSE in mm, with one line for each scenario.

    The smallest value of a scenario is bold. Survival follows in parentheses where it is below 100 %.
    """
    rows = []
    for scenario in comparison.scenarios:
        summaries = [comparison.summaries[scenario, policy] for policy in SHOWN]
        smallest = min(summary["penalised_rmse"].value for summary in summaries)
        row = [scenario]
        for summary in summaries:
            rmse = summary["penalised_rmse"].value
            number = f"**{format_number(rmse)}**" if rmse == smallest else format_number(rmse)
            row.append(with_survival(number, summary))
        rows.append(row)
    return markdown_table(["scenario", *SHOWN], rows)


def tuning() -> str:
    """Return a Markdown list with the tuning command and the score of each policy whose gains were tuned."""
    found = tuned()
    names = [name for name in CLASSICAL if name in found]
    return "\n".join(f"- `{found[name].command}`: {format_number(found[name].score)} mm" for name in names)


def main() -> None:
    """Evaluate, and write the folders and the page."""
    given = options(__doc__, 200)
    comparison = compare(
        [*map(training_seeds, (*LEARNED, *CLASSICAL))], ["test"], given.episodes, given.seed, CACHE, jobs=given.jobs
    )
    report.write(comparison, DOCS / "results")
    best, *others = (row.policy for row in comparison.ranking)
    sentences = [compare_pair(comparison.table, best, other).sentence() for other in others[:PAIRS]]
    parts = {
        "provenance": made_by("results", given.episodes, given.seed),
        "ranking": tables.markdown_rows(tables.ranking_rows(comparison)),
        "matrix": matrix(comparison),
        "pairwise": "\n".join(f"- {sentence}" for sentence in sentences),
        "tuning": tuning(),
    }
    fill(DOCS / "results.md", parts)
    for name in ("episodes.csv", "comparison.md"):  # too large for the repository
        shutil.move(DOCS / "results" / name, f"results/results_{name}")


if __name__ == "__main__":
    main()
