"""All files of a comparison: data, tables, figures, the HTML page, and the generated parts of a Markdown document."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from quadpend_train.common import documents
from quadpend_train.common.files import write_text
from quadpend_train.common.text import markdown_text
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.leaderboard import LeaderboardRow
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.reports import figures, html_page, learning_curves, replay, robustness_plots, tables
from quadpend_train.reports.learning_curves import Curves
from quadpend_train.studies import robustness
from quadpend_train.studies.robustness import Robustness

PARTS = ("provenance", "tuning", "leaderboard", "pairwise", "matrix", "robustness")  # of a document
FILES = ("report.html", "comparison.json", "comparison.csv", "comparison.md", "comparison.png")  # always written
PAIRS = 3  # number of pairwise comparisons in a document, of the best policy with the next ones


def write(
    comparison: Comparison,
    standings: Sequence[LeaderboardRow],
    measured: Robustness | None,
    folder: Path,
    curves: Curves | None = None,
    recordings: dict[str, Any] | None = None,
) -> list[str]:
    """Write all files of a comparison, and return their names.

    Args:
        comparison: Comparison to write.
        standings: Leaderboard of the comparison.
        measured: Robustness of the same policies, or None.
        folder: Folder for the files.
        curves: Learning curves of the learned policies, see `quadpend_train.reports.learning_curves`, or None.
        recordings: Episodes for the replay, see `quadpend_train.reports.replay.record_replay`, or None.
    """
    comparison.save(folder)
    write_text(folder / "comparison.md", tables.markdown(comparison, standings))
    pictures = {"comparison.png": tables.plot(comparison)}
    if curves:
        pictures["learning.png"] = learning_curves.draw(curves)
    if measured:
        measured.save(folder)
        pictures["curves.png"] = robustness_plots.curves(measured)
        pictures |= {f"{name}.png": robustness_plots.maps(measured, name) for name in measured.start_grids}
    for name, figure in pictures.items():
        figures.write_png(figure, folder / name)
    sections = [replay.section(recordings)] if recordings else []
    html_page.write(comparison, standings, measured, folder / "report.html", sections)
    data = ["comparison.json", "comparison.csv", "comparison.md"] + ["robustness.json"] * bool(measured)
    return ["report.html", *data, *pictures]


def update_document(
    comparison: Comparison,
    standings: Sequence[LeaderboardRow],
    measured: Robustness | None,
    path: Path,
    bound: LeaderboardRow | None = None,
) -> None:
    """Update the `PARTS` of a Markdown document.

    Args:
        comparison: Comparison to describe.
        standings: Leaderboard of the comparison.
        measured: Robustness of the same policies; None leaves that part as it is.
        path: Markdown file.
        bound: Row above the leaderboard, see `quadpend_train.evaluation.bound`, or None.

    Raises:
        ValueError: If the document does not contain the comments of a part exactly once.
    """
    best, *others = (row.policy for row in standings)
    pairs = [f"- {markdown_text(compare_pair(comparison, best, other).sentence())}" for other in others[:PAIRS]]
    made = comparison.provenance()
    provenance = (
        f"`{shlex.join(made['provenance']['command'])}`: {comparison.episodes} episodes in each scenario, seeds from"
        f" {comparison.seed}; scenario file `{made['scenario_file']}`, code `{made['code']}`."
    )
    parts = {
        "provenance": provenance,
        "tuning": tables.tuning_markdown(comparison.policies),
        "leaderboard": tables.leaderboard_markdown(standings, bound),
        "pairwise": "\n".join(pairs),
        "matrix": tables.matrix_markdown(comparison),
    }
    if measured:
        parts["robustness"] = robustness.markdown(measured)
    documents.fill(path, parts)
