"""Train PPO, SAC, TQC or APG, and resume interrupted runs.

The files of a run folder:

- ``settings.json``: all settings;
- ``provenance.json``: command, commit, package versions and machine;
- ``events*``: TensorBoard's event files;
- ``checkpoint.zip``: the latest checkpoint, for SAC and TQC with ``buffer_*.pkl``; deleted when the run is finished;
- ``curve.csv`` and ``best.npz``: scores and best policy, if the run is evaluated;
- ``model.zip``: the final model;
- ``policy.npz``: the best policy, or the final one if the run is not evaluated.

``settings.json`` is written last when a run begins, and ``policy.npz`` last when it ends. Every file is replaced as a
whole. So an interrupted run resumes from its latest checkpoint, with new episodes.
"""

import json
import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock, Timeout
from stable_baselines3.common.callbacks import BaseCallback, CallbackList

from quadpend_train.common.files import atomic, write_text
from quadpend_train.common.interruptions import progress_bar
from quadpend_train.common.provenance import provenance
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.policies.from_sb3 import export
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.algorithms import load_actor, load_model, make_model
from quadpend_train.training.callbacks import (
    BEST,
    CHECKPOINT,
    Checkpoints,
    EvaluationCallback,
    Report,
    Score,
    StopConditions,
    first_seed,
    save_checkpoint,
    validate,
)
from quadpend_train.training.dagger import Imitation
from quadpend_train.training.environment import make_env
from quadpend_train.training.settings import TrainSettings, read_settings, to_mapping

SETTINGS, PROVENANCE, POLICY = "settings.json", "provenance.json", "policy.npz"
CARD_SEED = VALIDATION_SEED + 100_000  # of the score on a policy's card; `best.npz` is selected in other episodes


def train(
    settings: TrainSettings, folder: Path, *, progress: bool = True, callbacks: Sequence[BaseCallback] = ()
) -> Path:
    """Train a policy from scratch in a new folder, and return its path; see `resume` for an interrupted run.

    `callbacks` are additional callbacks of Stable-Baselines3.

    Raises:
        FloatingPointError: If training diverged.
    """
    if (folder / SETTINGS).exists():
        raise FileExistsError(f"{folder} contains a run already: resume it, or choose another folder")
    model = initial_model(settings, folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        for name, data in ((PROVENANCE, provenance()), (SETTINGS, to_mapping(settings))):
            write_text(folder / name, json.dumps(data, indent=1) + "\n")
        return _run(model, settings, folder, progress, callbacks)


def resume(folder: Path, settings: TrainSettings | None = None, *, progress: bool = True) -> Path:
    """Continue an interrupted run from its latest checkpoint, or from scratch if it has none, as `train` does.

    Loading a checkpoint executes code that is in it: resume only runs whose source you trust. Only `max_seconds` may be
    changed.
    """
    if not (folder / SETTINGS).is_file():
        raise FileNotFoundError(f"{folder} contains no run")
    stored = read_settings(str(folder / SETTINGS))
    settings = settings or stored
    for name, value in vars(stored).items():
        if name != "max_seconds" and getattr(settings, name) != value:
            raise ValueError(f"a continued run may change max_seconds only: {name} must be {value!r}")
    with locked(folder):
        if (folder / POLICY).is_file():
            raise FileNotFoundError(f"the run in {folder} is finished: there is nothing to resume")
        if not (folder / CHECKPOINT).is_file():
            return _run(initial_model(settings, folder), settings, folder, progress)
        torch.set_num_threads(settings.num_threads)
        model = load_model(settings, make_env(settings), folder / CHECKPOINT)
        if hasattr(model, "replay_buffer"):
            model.load_replay_buffer(folder / f"buffer_{model.num_timesteps}.pkl")
        return _run(model, settings, folder, progress)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Let no other process train in a folder during the block. The operating system releases the lock of a process."""
    try:
        with FileLock(folder / ".lock", timeout=0):
            yield
    except Timeout:
        raise BlockingIOError(f"another process trains in {folder}: wait, or choose another folder") from None


def initial_model(settings: TrainSettings, folder: Path | None = None) -> Any:
    """Return the model of a run before imitation and training, with the network of `start_from` if there is one.

    TensorBoard's event files are in `folder`.
    """
    torch.set_num_threads(settings.num_threads)
    env = make_env(settings)
    model = make_model(settings, env, folder)
    if settings.start_from:
        load_actor(model, settings)
    return model


def imitate(model: Any, settings: TrainSettings) -> None:
    """Train the actor to imitate the base controller.

    Imitation uses no rewards: its environment has no baseline copies.
    """
    hybrid = replace(settings.hybrid, baseline_relative_reward=False, failure_penalty=0.0)
    env = make_env(replace(settings, hybrid=hybrid), teaches=True)
    env.seed(first_seed(settings) + 2**31)  # the middle of the run's block of seeds: training uses the first half
    Imitation(model, env, settings).fit()


def _run(
    model: Any, settings: TrainSettings, folder: Path, progress: bool, callbacks: Sequence[BaseCallback] = ()
) -> Path:
    """Imitate, learn, and write model and policy. After an imitation, the model is the first checkpoint."""
    end = time.perf_counter() + (settings.max_seconds or float("inf"))
    try:
        if settings.hybrid.imitation_timesteps and not (folder / CHECKPOINT).is_file():
            imitate(model, settings)
            save_checkpoint(model, folder)
        return _learn(model, settings, folder, end, progress, callbacks)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"`quadpend train --resume {shlex.quote(str(folder))}` continues the run") from None


def _learn(
    model: Any, settings: TrainSettings, folder: Path, end: float, progress: bool, callbacks: Sequence[BaseCallback]
) -> Path:
    stop, evaluation = StopConditions(settings, end), EvaluationCallback(settings, folder)
    total, before = settings.total_timesteps, model.num_timesteps
    model.set_random_seed((settings.seed * 1_000_003 + before) % 2**32)  # a resumed run draws other numbers
    model.get_env().seed(first_seed(settings) + before)
    with progress_bar(total=total, initial=before, unit="step", unit_scale=True, disable=not progress) as bar:
        all_of = [Checkpoints(settings, folder), stop, evaluation, *callbacks, Report(bar, evaluation)]
        try:
            model.learn(max(total - before, 0), CallbackList(all_of), reset_num_timesteps=False, tb_log_name="events")
            stop.check_finite()
        except ValueError:  # torch refuses a distribution whose parameters are not finite
            stop.check_finite()
            raise
    if stop.time_is_up:
        print(f"max_seconds ended the training early, after {model.num_timesteps} of {total} timesteps.")
    with atomic(folder / "model.zip") as unfinished:
        model.save(unfinished)
    policy = _final_policy(model, settings, folder, evaluation.scores, time.perf_counter() - evaluation.begin)
    if stop.time_is_up:
        policy.card["stopped_by"] = "max_seconds"
    policy.save(folder / POLICY)
    for leftover in (folder / CHECKPOINT, *folder.glob("buffer_*.pkl"), *folder.glob("unfinished_*")):
        leftover.unlink(missing_ok=True)
    return folder / POLICY


def _final_policy(
    model: Any, settings: TrainSettings, folder: Path, curve: Sequence[Score], seconds: float
) -> MlpPolicy:
    """Return the policy of a finished run with its card."""
    policy = MlpPolicy.load(folder / BEST) if curve else export(model, **settings.policy_interface())
    survival, rmse = validate(policy, settings, CARD_SEED)
    simulations = [scenario.simulation for scenario in settings.scenarios]
    vehicles = {simulation.vehicle.name for simulation in simulations}
    card = {
        **policy.card,
        "interface": simulations[0].interface,
        "vehicle": vehicles.pop() if len(vehicles) == 1 else "any",
        "settings": to_mapping(settings),
        "seed": settings.seed,
        "steps": model.num_timesteps,
        "seconds": round(curve[-1].seconds if curve else seconds, 1),
        "score": {"survival": survival, "penalised_rmse": rmse},
        "curve": [list(score) for score in curve],
        "provenance": json.loads((folder / PROVENANCE).read_text(encoding="utf-8")),
    }
    return MlpPolicy(policy.layers, card)
