"""Training PPO, SAC or TQC on the native vector environment.

A run folder holds everything that a run is: `settings.json` (resolved), `provenance.json` (versions, commit, hardware),
`checkpoint.zip` (the latest; for SAC and TQC with `buffer.pkl`), `curve.csv` and `best.npz` (if it is evaluated),
TensorBoard's events, and at the end `model.zip` and `policy.npz`, which is the best policy, or the last without
evaluations. Interrupted, a run goes on from its checkpoint as if nothing had been.
"""

import json
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback, CallbackList

from quadpend_train.common.provenance import provenance
from quadpend_train.common.version_0_1 import provenance_file
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.policies.export import export
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.policies.sb3_models import algorithm_class
from quadpend_train.scenarios import expand, find_scenario, scenario_hash
from quadpend_train.training.algorithms import make_model
from quadpend_train.training.callbacks import (
    BEST,
    DIVERGED,
    CheckpointSegments,
    EvaluationCallback,
    ProgressBar,
    RewardTerms,
    StopConditions,
    first_episode,
    read_curve,
)
from quadpend_train.training.dagger import dagger
from quadpend_train.training.environment import check_curriculum, make_env
from quadpend_train.training.settings import TrainSettings, read_settings, to_mapping
from quadpend_train.training.validation import validate

CARD_SEED = VALIDATION_SEED + 100_000  # of the episodes behind a card's score, on which no policy was chosen
SETTINGS, PROVENANCE, CHECKPOINT = "settings.json", "provenance.json", "checkpoint.zip"
MODEL, POLICY = "model.zip", "policy.npz"


def train(settings: TrainSettings, folder: Path, *, progress: bool = True, more: Sequence[BaseCallback] = ()) -> Path:
    """Train from scratch.

    Args:
        settings: of the run; those of a run to go on with are in its folder, see `resume`.
        folder: of the run.
        progress: whether to draw a progress bar.
        more: callbacks of one's own.

    Returns:
        The path of the trained policy.

    Raises:
        FileExistsError: the folder holds a run already.
        FloatingPointError: training diverged.
    """
    if (folder / SETTINGS).exists():
        raise FileExistsError(f"{folder} holds a run already: resume it, or choose another folder")
    model = fresh_model(settings, folder)
    folder.mkdir(parents=True, exist_ok=True)
    _write_json(folder / SETTINGS, to_mapping(settings))
    _write_json(folder / PROVENANCE, provenance())
    return _learn(model, settings, folder, progress, more)


def resume(folder: Path, *, progress: bool = True) -> Path:
    """Go on with an interrupted run, from its last checkpoint or, if it has none, from scratch.

    Returns:
        The path of the trained policy.

    Raises:
        FileNotFoundError: the folder holds no run, or a finished one.
        FloatingPointError: training diverged.
    """
    if not (folder / SETTINGS).is_file():
        raise FileNotFoundError(f"{folder} holds no run")
    if (folder / POLICY).is_file():
        raise FileNotFoundError(f"the run in {folder} is finished: there is nothing to go on with")
    settings = read_settings(str(folder / SETTINGS))
    if not (folder / CHECKPOINT).is_file():
        return _learn(fresh_model(settings, folder), settings, folder, progress)
    torch.set_num_threads(settings.num_threads)
    model = algorithm_class(settings.algo).load(folder / CHECKPOINT, env=make_env(settings), device="cpu")
    if settings.algo != "ppo":
        model.load_replay_buffer(folder / f"buffer_{model.num_timesteps}.pkl")
    return _learn(model, settings, folder, progress)


def fresh_model(settings: TrainSettings, folder: Path | None) -> Any:
    """The model that a run begins with: untrained, or an imitation of its companion."""
    torch.set_num_threads(settings.num_threads)
    env = make_env(settings)
    if settings.curriculum:
        check_curriculum(settings)
    model = make_model(settings, env, folder)
    if settings.hybrid.imitation_timesteps:
        env.seed(first_episode(settings) + 2**31)  # half a block away from all other episodes of the run
        left = dagger(model, env, settings)
        print(f"Imitation of {settings.hybrid.base_controller}: actions differ by {left:.4f} (root mean square).")
    return model


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def _learn(
    model: Any, settings: TrainSettings, folder: Path, progress: bool, more: Sequence[BaseCallback] = ()
) -> Path:
    steps, began = settings.total_timesteps - model.num_timesteps, time.perf_counter()
    watch, evaluate = StopConditions(settings), EvaluationCallback(settings, folder)
    callbacks = [CheckpointSegments(settings, folder), watch, evaluate, RewardTerms(), *more]
    if progress:
        callbacks.append(ProgressBar(settings, evaluate))
    terminate = signal.signal(signal.SIGTERM, _interrupt)
    try:
        model.learn(max(steps, 0), CallbackList(callbacks), reset_num_timesteps=False, tb_log_name="events")
        watch.check()
    except KeyboardInterrupt:
        print(f"Interrupted after {model.num_timesteps} steps; `quadpend train --resume {folder}` goes on.")
        raise
    except ValueError as error:  # of a distribution whose parameters are no numbers
        watch.check()
        if "found invalid values" in str(error):
            raise FloatingPointError(DIVERGED.format(model.num_timesteps)) from error
        raise
    finally:
        signal.signal(signal.SIGTERM, terminate)
    model.save(folder / MODEL)
    seconds = time.perf_counter() - began - evaluate.flown
    _policy(model, settings, folder, seconds).save(folder / POLICY)
    for leftover in (folder / CHECKPOINT, *folder.glob("buffer_*.pkl")):
        leftover.unlink(missing_ok=True)
    return folder / POLICY


def _policy(model: Any, settings: TrainSettings, folder: Path, seconds: float) -> MlpPolicy:
    """What a run has learned, with its card."""
    best = folder / BEST
    policy = MlpPolicy.load(best) if best.is_file() else export(model, **settings.policy_interface())
    curve = read_curve(folder)
    survival, rmse = validate(policy, settings, CARD_SEED)
    best_at = min(curve, key=lambda score: score.penalised_rmse).steps if best.is_file() else model.num_timesteps
    card = {
        **policy.card,
        "settings": to_mapping(settings),
        "seed": settings.seed,
        "steps": model.num_timesteps,
        "best_at": best_at,
        "seconds": round(curve[-1].seconds if curve else seconds, 1),
        "score": {"survival": survival, "penalised_rmse": rmse},
        "curve": [list(score) for score in curve],
        "scenarios": {
            name: scenario_hash(find_scenario(name)) for name in expand((*settings.scenario, *settings.curriculum))
        },
        "provenance": json.loads(provenance_file(folder, PROVENANCE).read_text(encoding="utf-8")),
    }
    return MlpPolicy(policy.layers, card)


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
