"""`quadpend train --seeds`: several training seeds, each in a run folder of its own."""

import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from quadpend_train.common.executors import run as run_calls
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import TrainSettings, read_settings, scenario_text, settings_of_card
from quadpend_train.training.train import POLICY, SETTINGS, train_or_resume


def parse_seeds(text: str) -> list[int]:
    """Return the seeds of a text such as ``"0-4"`` or ``"0,2,5-7"``."""
    found = [re.fullmatch(r"(\d{1,6})(?:-(\d{1,6}))?", part.strip()) for part in text.split(",")]
    ranges = [range(int(part[1]), int(part[2] or part[1]) + 1) for part in found if part]
    seeds = [seed for numbers in ranges for seed in numbers]
    if not all(found) or not all(ranges) or len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds must be different numbers and ranges such as 0-4 or 0,2,5, not {text!r}")
    return seeds


def run_folders(out: Path, seeds: str) -> dict[int, Path]:
    """Return the folder of each training seed."""
    return {seed: out.with_name(f"{out.name}-{seed}") for seed in parse_seeds(seeds)}


def begun(folders: Sequence[Path]) -> list[Path]:
    """Return the folders that contain a run, finished or not."""
    return [folder for folder in folders if (folder / SETTINGS).is_file()]


def train_seeds(run: TrainSettings, seeds: str, out: Path, resume: bool, jobs: int) -> list[Path]:
    """Train with each seed, and return the run folders. Finished runs are skipped, and interrupted ones continue.

    The runs have the settings `run` with other seeds, and the names of their folders begin with `out`. Interrupted runs
    are refused unless `resume` is true.
    """
    folders, calls = run_folders(out, seeds), {}
    if resume and not begun([*folders.values()]):
        raise FileNotFoundError(f"{', '.join(map(str, folders.values()))} contain no run")
    for seed, folder in folders.items():
        settings = replace(run, seed=seed)
        print(f"{folder}: {_state(folder, settings, resume)}", flush=True)
        if not (folder / POLICY).is_file():
            calls[f"seed {seed}"] = partial(train_or_resume, settings, folder, progress=False)
    try:
        run_calls(calls, jobs, what="training", finished=len(folders) - len(calls))
    except KeyboardInterrupt:
        command = f"quadpend train --resume {shlex.quote(str(out))} --seeds {seeds}"
        raise KeyboardInterrupt(f"`{command}` continues the runs" if begun([*folders.values()]) else "") from None
    return [*folders.values()]


def _state(folder: Path, settings: TrainSettings, resume: bool) -> str:
    """Return what will be done with a folder."""
    if not begun([folder]):
        return "a new run"
    if replace(read_settings(str(folder / SETTINGS)), max_seconds=settings.max_seconds) != settings:
        raise ValueError(f"{folder} contains a run with other settings: choose another folder with --out")
    if (folder / POLICY).is_file():
        return "finished, skipped"
    if not resume:
        raise ValueError(f"{folder} contains an interrupted run: give --resume instead of --out to continue it")
    return "interrupted, continues from its last checkpoint"


def summary(folders: Sequence[Path], given: Sequence[str]) -> str:
    """Return a line about each policy, and the command that compares them in the scenarios that were `given`."""
    lines = []
    for path in (folder / POLICY for folder in folders):
        card = MlpPolicy.load(path).card
        lines.append(
            f"Trained policy: {path}\nIn its training scenarios it survives {card['score']['survival']:.1%} of the"
            f" episodes; penalised RMSE {1e3 * card['score']['penalised_rmse']:.1f} mm."
        )
    scenarios = given or [scenario_text(scenario) for scenario in settings_of_card(card, str(folders[-1])).scenarios]
    command = ["quadpend", "evaluate", "flatness", f"mine={','.join(map(str, folders))}", "--scenarios", *scenarios]
    return "\n".join([*lines, f"Compare with a classical controller: {shlex.join(command)}"])
