"""Evaluate policies and write the whole report: the page with its replay, tables, figures and data."""

from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from quadpend_train.common.files import writable_folder
from quadpend_train.evaluation import cache
from quadpend_train.evaluation.comparison import Comparison, Policies, Scenarios, compare, named_policies
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.evaluation.leaderboard import LeaderboardRow, leaderboard
from quadpend_train.policies.loading import load_policies, policy_names
from quadpend_train.reports import learning_curves, results, tables
from quadpend_train.reports.replay import record_replay
from quadpend_train.studies.robustness import Robustness, measure_robustness


@dataclass(frozen=True)
class Report:
    """What `evaluate` found and wrote; as text, it is one sentence for each scenario and policy.

    Attributes:
        comparison: Metrics and episodes of every policy in every scenario.
        leaderboard: The policies in the order of their mean penalised RMSE.
        robustness: Robustness of the policies, if it was measured.
        folder: Folder of the files.
        files: Names of the files, `report.html` first.
    """

    comparison: Comparison
    leaderboard: list[LeaderboardRow]
    robustness: Robustness | None
    folder: Path
    files: list[str]

    def __str__(self) -> str:
        return "\n".join([*tables.verdicts(self.comparison), f"Written: {self.folder}/{', '.join(self.files)}"])


def evaluate(
    policies: Policies,
    scenarios: Scenarios = ("calm", "windy"),
    out: str | Path = "results",
    *,
    episodes: int = 100,
    seed: int = VALIDATION_SEED,
    jobs: int | Executor = 1,
    cache_folder: cache.Folder | None = None,
    recompute: bool = False,
    robustness: int = 0,
    replay: int = 2,
) -> Report:
    """Run policies through the same episodes, compare them with the first one, and write the report into a folder.

    The command `quadpend evaluate` calls this function.

    Args:
        policies: Policies, by name or as objects, see `quadpend_train.evaluation.comparison.compare`.
        scenarios: Scenarios, by name or as objects, see the same function.
        out: Folder for report.html, comparison.json, .csv, .md and .png, and figures of robustness; it is created.
        episodes: Number of episodes in each scenario.
        seed: Seed of the first episode.
        jobs: Number of processes, or an executor of `quadpend_train.common.executors`; the results do not depend on it.
        cache_folder: Folder of cached results; only missing results are computed. None: no cache.
        recompute: Whether to ignore cached results.
        robustness: Number of episodes at each value of the perturbation axes; 0 omits the robustness. Of a learner with
            several training seeds, the first is evaluated.
        replay: Number of episodes of each scenario that the page can replay; 0 omits the replay.

    Raises:
        TypeError: If a policy or a scenario has the wrong type.
        ValueError: If a policy or a scenario is refused, see `compare`, a number is out of range, or a folder cannot
            be written.
    """
    folder = writable_folder(Path(out))
    if cache_folder:
        cache.check_folder(cache_folder)
    named = named_policies(policies)
    comparison = compare(named, scenarios, episodes, seed, cache_folder, recompute, jobs)
    measured = None
    if robustness:
        first_seeds = {
            name: policy_names(members)[0] if isinstance(members, str) else members[:1]
            for name, members in named.items()
        }
        measured = measure_robustness(
            first_seeds,
            episodes=robustness,
            seed=seed,
            cache_folder=cache_folder,
            recompute=recompute,
            jobs=jobs,
            base=next(iter(comparison.scenarios.values())),
        )
    standings = leaderboard(comparison)
    loaded = {name: load_policies(item) if isinstance(item, str) else item for name, item in named.items()}
    recordings = record_replay(comparison, standings, loaded, replay)
    files = results.write(comparison, standings, measured, folder, learning_curves.collect(loaded), recordings)
    return Report(comparison, standings, measured, folder, files)
