"""Evaluate policies and write the whole report: the page with its replay, tables, figures and data."""

import json
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from quadpend_train.common.files import writable_folder, write_text
from quadpend_train.evaluation.comparison import Comparison, Policies, Scenarios, compare
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.leaderboard import LeaderboardRow, leaderboard
from quadpend_train.evaluation.table import summary_table
from quadpend_train.reports import figures, html_page, learning_curves, tables
from quadpend_train.reports.replay import record_replay

FILES = ("report.html", "comparison.json", "comparison.csv", "comparison.md", "episodes.csv")


@dataclass(frozen=True)
class Report:
    """What `evaluate` found and wrote; as text, it is one sentence for each policy but the first.

    Attributes:
        comparison: Table of all episodes, with the metrics of every policy in every scenario.
        leaderboard: The policies in the order of their mean penalised RMSE.
        folder: Folder of the files.
        files: Names of the files, `report.html` first.
    """

    comparison: Comparison
    leaderboard: list[LeaderboardRow]
    folder: Path
    files: list[str]

    def __str__(self) -> str:
        return "\n".join([*tables.sentences(self.comparison), f"Written: {self.folder}/{', '.join(self.files)}"])


def evaluate(
    policies: Policies,
    scenarios: Scenarios = ("calm", "windy"),
    out: str | Path = "results",
    *,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    jobs: int | Executor = 1,
    cache_folder: Path | str | None = None,
    recompute: bool = False,
    replay: int = 2,
) -> Report:
    """Run policies through the same episodes, compare them with the first one, and write the report into a folder.

    The command `quadpend evaluate` calls this function.

    Args:
        policies: Policies, by name or as objects, see `quadpend_train.evaluation.comparison.compare`.
        scenarios: Scenarios, by name or as objects, see the same function.
        out: Folder for the files; it is created.
        episodes: Number of episodes in each scenario.
        seed: Seed of the first episode.
        jobs: Number of processes, or an executor of `quadpend_train.common.executors`; the results do not depend on it.
        cache_folder: Folder of cached results; only missing results are computed. None: no cache.
        recompute: Whether to ignore cached results.
        replay: Number of episodes of each scenario that the page can replay; 0 omits the replay.
    """
    folder = writable_folder(Path(out))
    if cache_folder:
        writable_folder(Path(cache_folder), "cache")
    comparison = compare(policies, scenarios, episodes, seed, cache_folder, recompute, jobs)
    standings = leaderboard(comparison.table)
    return Report(comparison, standings, folder, write(comparison, standings, folder, replay))


def write(comparison: Comparison, standings: list[LeaderboardRow], folder: Path, replay: int = 0) -> list[str]:
    """Write all files of a comparison with its leaderboard into a folder, and return their names."""
    provenance = f"# {json.dumps(comparison.table.attrs)}\n"
    for name, table in (("comparison", summary_table(comparison.summaries)), ("episodes", comparison.table)):
        write_text(folder / f"{name}.csv", provenance + table.to_csv(index=False, lineterminator="\n"))
    write_text(folder / "comparison.md", tables.markdown(comparison, standings))
    data = json.dumps(html_page.as_data(comparison), indent=1, allow_nan=False)
    write_text(folder / "comparison.json", data + "\n")
    pictures = {"comparison.png": tables.plot(comparison)}
    if curves := learning_curves.draw(comparison.learners):
        pictures["learning.png"] = curves
    for name, figure in pictures.items():
        figures.write_png(figure, folder / name)
    recordings = record_replay(comparison, standings, replay)
    html_page.write(comparison, standings, folder / "report.html", recordings)
    return [*FILES, *pictures]
