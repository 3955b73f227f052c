"""`quadpend train --seeds`: several training seeds, each in a run folder of its own."""

import re
import shlex
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from quadpend_train.common.executors import run as run_calls
from quadpend_train.common.files import writable_folder
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training import train as training
from quadpend_train.training.run_folder import POLICY, SETTINGS
from quadpend_train.training.settings import TrainSettings, read_settings

_MOST = 1000  # seeds


def parse_seeds(text: str) -> list[int]:
    """Return the seeds of a text such as ``"0-4"`` or ``"0,2,5-7"``.

    Raises:
        ValueError: If it is not such a text, or a seed is repeated.
    """
    seeds: list[int] = []
    for part in text.split(","):
        found = re.fullmatch(r"(\d{1,18})(?:-(\d{1,18}))?", part.strip())
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
        if not first <= last < first + _MOST:
            raise ValueError(f"seeds must be numbers and ranges such as 0-4 or 0,2,5, not {text!r}")
        seeds += range(first, last + 1)
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds must be different, not {text!r}")
    return seeds


def run_folder(out: Path, seed: int) -> Path:
    """Return the folder of the run of a training seed."""
    return out.with_name(f"{out.name}-{seed}")


def begun(out: Path, seeds: list[int]) -> list[Path]:
    """Return the folders of the seeds that contain a run, finished or not."""
    return [folder for seed in seeds if (folder := run_folder(out, seed)).joinpath(SETTINGS).is_file()]


def train_seeds(run: TrainSettings, seeds: list[int], out: Path, resume: bool, execute: Executor) -> list[Path]:
    """Train with each seed. Finished runs are skipped, and interrupted ones continue.

    Args:
        run: Settings, whose seed is replaced.
        seeds: The training seeds.
        out: Start of the names of the run folders.
        resume: Whether to continue interrupted runs.
        execute: What runs the trainings.

    Returns:
        The folders of the runs.

    Raises:
        CallsFailedError: If trainings fail; the others are finished.
        ValueError: If a folder has an interrupted run and `resume` is False, or a run with other settings.
    """
    writable_folder(out.parent)
    folders = {seed: run_folder(out, seed) for seed in seeds}
    calls = {}
    for seed, folder in folders.items():
        settings = replace(run, seed=seed)
        print(f"{folder}: {_state(folder, settings, resume)}", flush=True)
        if not (folder / POLICY).is_file():
            calls[f"seed {seed}"] = partial(training.train_or_resume, settings, folder, progress=False)
    run_calls(calls, execute, what="training", kept=f"are in {out}-…", finished=len(seeds) - len(calls))
    return list(folders.values())


def _state(folder: Path, settings: TrainSettings, resume: bool) -> str:
    """Return what will be done with a folder.

    Raises:
        ValueError: If it contains a run that cannot be used.
    """
    if not (stored := folder / SETTINGS).is_file():
        return "a new run"
    limits: dict[str, Any] = dict.fromkeys(training.LIMITS, 0)
    if replace(read_settings(str(stored)), **limits) != replace(settings, **limits):
        raise ValueError(f"{folder} contains a run with other settings: choose another folder with --out")
    if (folder / POLICY).is_file():
        return "finished, skipped"
    if not resume:
        raise ValueError(f"{folder} contains an interrupted run: give --resume instead of --out to continue it")
    return "interrupted, continues from its last checkpoint"


def how_to_continue(out: Path, seeds: str, jobs: int = 1, cluster: str | None = None) -> str:
    """Return how interrupted trainings continue; empty if nothing has been written."""
    if not begun(out, parse_seeds(seeds)):
        return ""
    where = f" --jobs {jobs}" if jobs > 1 else f" --cluster {cluster}" if cluster else ""
    return f"`quadpend train --resume {shlex.quote(str(out))} --seeds {seeds}{where}` continues the runs"


def summary(folders: list[Path]) -> str:
    """Return a line about each policy, and the command that compares them with a classical controller."""
    lines = []
    for folder in folders:
        card = MlpPolicy.load(folder / POLICY).card
        survival, rmse = card["score"]["survival"], card["score"]["penalised_rmse"]
        lines.append(f"{folder}: survives {survival:.1%} of the episodes; penalised RMSE {1e3 * rmse:.1f} mm.")
    command = ["quadpend", "evaluate", "flatness", f"mine={','.join(map(str, folders))}", "--scenarios"]
    lines.append(f"Compare them with a classical controller: {shlex.join([*command, *card['settings']['scenarios']])}")
    return "\n".join(lines)
