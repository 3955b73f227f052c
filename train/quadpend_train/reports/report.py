"""Evaluate policies and write the whole report: the page, tables and data."""

import json
from dataclasses import dataclass
from pathlib import Path

from quadpend_train.common.files import write_text
from quadpend_train.evaluation.comparison import Comparison, Policies, Scenarios, compare
from quadpend_train.evaluation.episodes import TEST_SEED
from quadpend_train.evaluation.metrics import summary_table
from quadpend_train.reports import html_page, tables

FILES = ("report.html", "comparison.csv", "comparison.md", "episodes.csv")


@dataclass(frozen=True)
class Report:
    """What `evaluate` found; as text, it is one sentence for each policy but the first, and the names of the files."""

    comparison: Comparison
    folder: Path

    def __str__(self) -> str:
        return "\n".join([*tables.sentences(self.comparison), f"Written: {self.folder}/{', '.join(FILES)}"])


def evaluate(
    policies: Policies,
    scenarios: Scenarios = ("calm", "windy"),
    out: str | Path = "results",
    *,
    episodes: int = 100,
    seed: int = TEST_SEED,
    jobs: int = 1,
    cache_folder: Path | str | None = None,
) -> Report:
    """Run policies through the same episodes, compare them with the first one, and write the report into a folder.

    The command `quadpend evaluate` calls this function. `out` is the folder for the files, which is created. The other
    arguments are those of `quadpend_train.evaluation.comparison.compare`.
    """
    (folder := Path(out)).mkdir(parents=True, exist_ok=True)
    comparison = compare(policies, scenarios, episodes, seed, cache_folder, jobs)
    write(comparison, folder)
    return Report(comparison, folder)


def write(comparison: Comparison, folder: Path) -> None:
    """Write all files of a comparison into a folder."""
    provenance = f"# {json.dumps(comparison.table.attrs)}\n"
    for name, table in (("comparison", summary_table(comparison.summaries)), ("episodes", comparison.table)):
        write_text(folder / f"{name}.csv", provenance + table.to_csv(index=False, lineterminator="\n"))
    write_text(folder / "comparison.md", tables.markdown(comparison))
    html_page.write(comparison, folder / "report.html")
