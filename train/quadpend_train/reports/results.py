"""Everything that is written of a comparison: data, tables, pictures, the page, and parts of documents."""

import shlex
from pathlib import Path
from typing import Any

from quadpend_train.common import documents
from quadpend_train.evaluation.comparison import Comparison
from quadpend_train.evaluation.leaderboard import leaderboard
from quadpend_train.evaluation.pairwise import compare_pair
from quadpend_train.reports import figures, html_page, learning_curves, replay, robustness_plots, tables
from quadpend_train.reports.learning_curves import Curves
from quadpend_train.studies import robustness
from quadpend_train.studies.robustness import Robustness

PARTS = ("provenance", "tuning", "leaderboard", "duels", "matrix", "robustness")  # of a document
DUELS = 3  # that a document tells of: the best against the ones behind it


def write(
    comparison: Comparison,
    endured: Robustness | None,
    folder: Path,
    curves: Curves | None = None,
    recordings: dict[str, Any] | None = None,
) -> list[str]:
    """Write all files of a comparison.

    Args:
        comparison: what it is about.
        endured: the robustness of the same policies; None: without.
        folder: for the files.
        curves: of the learned policies among them, see `quadpend_train.reports.learning_curves`.
        recordings: what the page replays, see `quadpend_train.reports.replay.recorded`.

    Returns:
        Their names.
    """
    comparison.save(folder)
    (folder / "comparison.md").write_text(tables.markdown(comparison), encoding="utf-8")
    pictures = {"comparison.png": tables.plot(comparison)}
    if curves:
        pictures["learning.png"] = learning_curves.draw(curves)
    if endured:
        endured.save(folder)
        pictures["curves.png"] = robustness_plots.curves(endured)
        pictures |= {f"{name}.png": robustness_plots.maps(endured, name) for name in endured.start_grids}
    for name, figure in pictures.items():
        figures.png(figure, folder / name)
    html_page.write(comparison, endured, folder / "report.html", [replay.section(recordings)] if recordings else [])
    data = ["comparison.json", "comparison.csv", "comparison.md"] + ["robustness.json"] * bool(endured)
    return ["report.html", *data, *pictures]


def document(comparison: Comparison, endured: Robustness | None, path: Path) -> None:
    """Fill in the `PARTS` of a document.

    Raises:
        ValueError: the document has no place for one of them.
    """
    standings = leaderboard(comparison)
    best, *others = (standing.policy for standing in standings)
    duels = [f"- {compare_pair(comparison, best, other).sentence()}" for other in others[:DUELS]]
    origin = comparison.provenance()
    told = (
        f"`{shlex.join(origin['provenance']['command'])}`: {comparison.episodes} episodes in each scenario, seeds from"
        f" {comparison.seed}; scenario file `{origin['scenario_file']}`, code `{origin['code']}`."
    )
    parts = {
        "provenance": told,
        "tuning": tables.tuning_markdown(comparison.policies),
        "leaderboard": tables.leaderboard_markdown(standings),
        "duels": "\n".join(duels),
        "matrix": tables.matrix_markdown(comparison),
    }
    parts["robustness"] = robustness.markdown(endured) if endured else "Not measured."
    documents.fill(path, parts)
