"""Train PPO, SAC, TQC or APG, and resume interrupted runs.

The files of a run folder:

- ``settings.json``: all settings;
- ``start.npz``: the policy that training starts from, if any;
- ``provenance.json``: package versions, commit and machine;
- ``.lock``: its lock is held while a process trains in the folder;
- ``events*``: TensorBoard's event files;
- ``checkpoint.zip``: the latest checkpoint, for SAC and TQC with ``buffer_*.pkl``; deleted when the run is finished;
- ``curve.csv`` and ``best.npz``: scores and best policy, if the run is evaluated;
- ``model.zip``: the final model;
- ``policy.npz``: the best policy, or the final one if the run is not evaluated; of a continued run, ``policy_*.npz`` is
  the policy after its first part.

An interrupted run resumes from its latest checkpoint and gives the same policy as an uninterrupted run. A finished run
continues from its model, see `extend`.
"""

import signal
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback, CallbackList

from quadpend_gym.core.validation import check_int
from quadpend_gym.scenarios import check_own_models, expand_sets, find_scenario, scenario_hash
from quadpend_train.common.files import atomic
from quadpend_train.common.version_0_1 import provenance_file
from quadpend_train.evaluation.episodes import VALIDATION_SEED
from quadpend_train.policies.export import export
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.algorithms import load_model, make_model
from quadpend_train.training.callbacks import (
    DIVERGED,
    CheckpointSegments,
    EvaluationCallback,
    ProgressBar,
    RewardTerms,
    StopConditions,
    first_seed,
    save_checkpoint,
)
from quadpend_train.training.dagger import dagger
from quadpend_train.training.environment import check_curriculum, make_env
from quadpend_train.training.run_folder import (
    CHECKPOINT,
    MODEL,
    POLICY,
    PROVENANCE,
    SETTINGS,
    begin_continuation,
    complete_continuation,
    delete_checkpoint,
    locked,
    read_provenance,
    write_json,
    write_provenance,
)
from quadpend_train.training.settings import REPLAY_ALGORITHMS, TrainSettings, read_settings, to_mapping
from quadpend_train.training.start import START, load_actor, start_policy
from quadpend_train.training.time_limit import TimeLimit, TimeUpError
from quadpend_train.training.validation import BEST, Score, restore_scores, validate

CARD_SEED = VALIDATION_SEED + 100_000  # of the score on a policy's card; `best.npz` is selected in other episodes
STOPPED = (
    "max_seconds ended the training early, after {} of {} timesteps:"
    " `quadpend train --resume {} --more-steps {}` continues it."
)
LIMITS = ("max_seconds", "patience")  # settings that may be changed when a run is resumed


def train(
    settings: TrainSettings,
    folder: Path,
    *,
    progress: bool = True,
    callbacks: Sequence[BaseCallback] = (),
    started: float | None = None,
) -> Path:
    """Train a policy from scratch.

    Args:
        settings: The settings of the run.
        folder: The folder of the run; it is created. See `resume` for a folder with an interrupted run.
        progress: Whether to show a progress bar.
        callbacks: Additional callbacks of Stable-Baselines3.
        started: Time from which `max_seconds` is counted, as `time.perf_counter` returns it; None: this call.

    Returns:
        The path of the trained policy.

    Raises:
        BlockingIOError: If another process trains in the folder.
        FileExistsError: If the folder contains a run already.
        FloatingPointError: If training diverged.
    """
    limit = TimeLimit(settings.max_seconds, started)
    _check_empty(folder)
    model = _untrained_model(settings, folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        _check_empty(folder)
        if settings.start_from:
            start_policy(settings).save(folder / START)
        write_provenance(folder, settings)
        write_json(folder / SETTINGS, to_mapping(settings))
        return _begin(model, settings, folder, limit, progress, callbacks)


def _check_empty(folder: Path) -> None:
    if (folder / SETTINGS).exists():
        raise FileExistsError(f"{folder} contains a run already: resume it, or choose another folder")


def resume(
    folder: Path, settings: TrainSettings | None = None, *, progress: bool = True, started: float | None = None
) -> Path:
    """Continue an interrupted run from its latest checkpoint, or from scratch if it has none.

    Loading a checkpoint executes code that is in it: resume only runs whose source you trust.

    Args:
        folder: The folder of the run.
        settings: The settings of the run, in which only `LIMITS` may be changed; None: unchanged.
        progress: Whether to show a progress bar.
        started: Time from which `max_seconds` is counted, as `time.perf_counter` returns it; None: this call.

    Returns:
        The path of the trained policy.

    Raises:
        BlockingIOError: If another process trains in the folder.
        FileNotFoundError: If the folder contains no run, or a finished one.
        ValueError: If another setting is changed, or a file of a run of an earlier version is damaged.
        FloatingPointError: If training diverged.
    """
    if not (folder / SETTINGS).is_file():
        raise FileNotFoundError(f"{folder} contains no run")
    with locked(folder):
        if (folder / POLICY).is_file():
            delete_checkpoint(folder)  # if the process was killed after it had written the policy
            raise FileNotFoundError(f"the run in {folder} is finished: there is nothing to resume")
        complete_continuation(folder)
        settings = _checked_limits(read_settings(str(folder / SETTINGS)), settings)
        limit = TimeLimit(settings.max_seconds, started)
        if not provenance_file(folder, PROVENANCE).is_file():  # a killed process of an earlier version wrote it last
            write_provenance(folder, settings)
        if not (folder / CHECKPOINT).is_file():
            return _begin(_untrained_model(settings, folder, folder / START), settings, folder, limit, progress)
        torch.set_num_threads(settings.num_threads)
        model = load_model(settings, make_env(settings), folder / CHECKPOINT)
        restore_scores(model, settings, folder)
        if settings.algo in REPLAY_ALGORITHMS:
            model.load_replay_buffer(folder / f"buffer_{model.num_timesteps}.pkl")
        return _learn(model, settings, folder, limit, progress)


def train_or_resume(settings: TrainSettings, folder: Path, *, progress: bool = True) -> Path:
    """Train a policy, or continue the interrupted run in the folder, see `train` and `resume`.

    Args:
        settings: The settings of the run.
        folder: The folder of the run.
        progress: Whether to show a progress bar.

    Returns:
        The path of the trained policy.
    """
    begun = (folder / SETTINGS).is_file()
    return resume(folder, settings, progress=progress) if begun else train(settings, folder, progress=progress)


def extend(
    folder: Path,
    more_steps: int,
    settings: TrainSettings | None = None,
    *,
    progress: bool = True,
    started: float | None = None,
) -> Path:
    """Continue a finished run for more timesteps, with its networks and the state of its optimizers.

    The run then has ``total_timesteps`` equal to its timesteps so far plus `more_steps`, and no ``patience``. The
    learning rate is linear over this new total: it starts between its initial and its final value. The replay buffer of
    SAC and TQC was deleted at the end of the run, so they fill a new one with ``learning_starts`` random actions. The
    learning curve continues. An interrupted continuation is resumed by `resume`.

    Loading a model executes code that is in it: extend only runs whose source you trust.

    Args:
        folder: The folder of the run.
        more_steps: Number of timesteps.
        settings: The settings of the run, in which only ``max_seconds`` may be changed; None: unchanged.
        progress: Whether to show a progress bar.
        started: Time from which `max_seconds` is counted, as `time.perf_counter` returns it; None: this call.

    Returns:
        The path of the trained policy.

    Raises:
        BlockingIOError: If another process trains in the folder.
        FileNotFoundError: If the folder contains no finished run.
        FloatingPointError: If training diverged.
        ValueError: If `more_steps` is not a whole number of at least 1, or another setting is changed.
    """
    check_int(more_steps, "more_steps", 1)
    if not (folder / SETTINGS).is_file():
        raise FileNotFoundError(f"{folder} contains no run")
    if not (folder / POLICY).is_file() or not (folder / MODEL).is_file():
        raise FileNotFoundError(f"the run in {folder} is not finished: resume it without more steps first")
    with locked(folder):
        settings = _checked_limits(read_settings(str(folder / SETTINGS)), settings, LIMITS[:1])
        torch.set_num_threads(settings.num_threads)
        model = load_model(settings, make_env(settings), folder / MODEL)
        restore_scores(model, settings, folder)
        steps = model.num_timesteps
        if settings.algo in REPLAY_ALGORITHMS:
            model.learning_starts = steps + settings.sac.learning_starts
        save_checkpoint(model, folder)
        new = replace(settings, total_timesteps=steps + more_steps, patience=0)
        begin_continuation(folder, steps, to_mapping(new))
    return resume(folder, progress=progress, started=started)


def _checked_limits(
    stored: TrainSettings, settings: TrainSettings | None, limits: Sequence[str] = LIMITS
) -> TrainSettings:
    """Return `settings`, or `stored` if there are none, after checking that they differ in `limits` only."""
    if settings is None:
        return stored
    for name, value in vars(stored).items():
        if name not in limits and getattr(settings, name) != value:
            raise ValueError(f"a continued run may change {' and '.join(limits)} only: {name} must be {value!r}")
    return settings


def initial_model(settings: TrainSettings, folder: Path | None) -> Any:
    """Return the model with which a run starts: untrained, from a policy, or after imitation of the base controller.

    Args:
        settings: The settings of the run.
        folder: The folder for TensorBoard's event files; None writes no event files.
    """
    model = _untrained_model(settings, folder)
    _imitate(model, settings, TimeLimit(0.0))
    return model


def _untrained_model(settings: TrainSettings, folder: Path | None, start: Path | None = None) -> Any:
    """Return the model of a run, with the network of the policy `start_from` if the settings name one.

    Args:
        settings: The settings of the run.
        folder: The folder for TensorBoard's event files; None writes no event files.
        start: A copy of the policy `start_from`, which is used if it exists.
    """
    torch.set_num_threads(settings.num_threads)
    for name in expand_sets((*settings.scenarios, *settings.curriculum)):
        check_own_models(name, find_scenario(name))
    env = make_env(settings)
    if settings.curriculum:
        check_curriculum(settings)
    model = make_model(settings, env, folder)
    if settings.start_from:
        load_actor(model, settings, start)
    return model


def _imitate(model: Any, settings: TrainSettings, limit: TimeLimit) -> None:
    """Train the actor to imitate the base controller, if the settings say so.

    Imitation uses no rewards: its environment has no baseline copies.
    """
    if settings.hybrid.imitation_timesteps:
        hybrid = replace(settings.hybrid, baseline_relative_reward=False, failure_penalty=0.0)
        env = make_env(replace(settings, hybrid=hybrid))
        env.seed(first_seed(settings) + 2**31)  # the middle of the run's block of seeds: training uses the first half
        limit.predict(export(model, **settings.policy_interface()), settings)
        try:
            error = dagger(model, env, settings, limit.check)
        except TimeUpError:
            print(f"The imitation of {settings.hybrid.base_controller} was stopped by max_seconds.")
            return
        print(f"Imitation of {settings.hybrid.base_controller}: actions differ by {error:.4f} (root mean square).")


def _begin(
    model: Any,
    settings: TrainSettings,
    folder: Path,
    limit: TimeLimit,
    progress: bool,
    callbacks: Sequence[BaseCallback] = (),
) -> Path:
    """Imitate and learn. The first checkpoint of a run with imitation is the model after the imitation."""
    if settings.hybrid.imitation_timesteps:
        try:
            _imitate(model, settings, limit)
        except KeyboardInterrupt:
            print(f"Interrupted during the imitation; `quadpend train --resume {folder}` starts it again.")
            raise
        save_checkpoint(model, folder)
    return _learn(model, settings, folder, limit, progress, callbacks)


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def _handle_sigterm(handler: Any) -> Any:
    """Set the handler of SIGTERM and return the previous one; only the main thread can, elsewhere nothing changes."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    return signal.signal(signal.SIGTERM, handler) if in_main_thread else None


def _learn(
    model: Any,
    settings: TrainSettings,
    folder: Path,
    limit: TimeLimit,
    progress: bool,
    callbacks: Sequence[BaseCallback] = (),
) -> Path:
    limit.predict(export(model, **settings.policy_interface()), settings)
    steps, start = settings.total_timesteps - model.num_timesteps, time.perf_counter()
    stop, evaluation = StopConditions(settings, limit), EvaluationCallback(settings, folder, limit)
    callbacks = [CheckpointSegments(settings, folder), stop, evaluation, RewardTerms(), *callbacks]
    if progress:
        callbacks.append(ProgressBar(settings, evaluation))
    previous_handler = _handle_sigterm(_interrupt)
    try:
        model.learn(max(steps, 0), CallbackList(callbacks), reset_num_timesteps=False, tb_log_name="events")
        stop.check_finite()
        if limit.stopped:
            print(STOPPED.format(model.num_timesteps, settings.total_timesteps, folder, _missing(model, settings)))
    except KeyboardInterrupt:
        print(f"Interrupted after {model.num_timesteps} steps; `quadpend train --resume {folder}` continues the run.")
        raise
    except ValueError as error:  # torch refuses a distribution whose parameters are not finite
        stop.check_finite()
        if "found invalid values" in str(error):
            raise FloatingPointError(DIVERGED.format(model.num_timesteps)) from error
        raise
    finally:
        _handle_sigterm(previous_handler)
    with atomic(folder / MODEL) as unfinished:
        model.save(unfinished)
    seconds = time.perf_counter() - start - evaluation.evaluation_seconds
    policy = _final_policy(model, settings, folder, evaluation.scores, seconds)
    if limit.stopped:
        policy.card["stopped_by"] = "max_seconds"
    policy.save(folder / POLICY)
    delete_checkpoint(folder)
    return folder / POLICY


def _missing(model: Any, settings: TrainSettings) -> int:
    """Return how many timesteps a stopped run lacks: at least a rollout, whose gradient steps it has not made."""
    return max(settings.total_timesteps - int(model.num_timesteps), settings.rollout_timesteps())


def _final_policy(
    model: Any, settings: TrainSettings, folder: Path, curve: Sequence[Score], seconds: float
) -> MlpPolicy:
    """Return the policy of a finished run with its card."""
    policy = MlpPolicy.load(folder / BEST) if curve else export(model, **settings.policy_interface())
    survival, rmse = validate(policy, settings, CARD_SEED)
    best_at = min(curve, key=lambda score: score.penalised_rmse).steps if curve else model.num_timesteps
    simulation = find_scenario(expand_sets(settings.scenarios)[0]).simulation  # all scenarios have the same
    card = {
        **policy.card,
        "interface": simulation.interface,
        "vehicle": simulation.vehicle.name,
        "settings": to_mapping(settings),
        "seed": settings.seed,
        "steps": model.num_timesteps,
        "best_at": best_at,
        "seconds": round(curve[-1].seconds if curve else seconds, 1),
        "score": {"survival": survival, "penalised_rmse": rmse},
        "curve": [list(score) for score in curve],
        "scenarios": {
            name: scenario_hash(find_scenario(name))
            for name in expand_sets((*settings.scenarios, *settings.curriculum))
        },
        "provenance": read_provenance(folder),
    }
    return MlpPolicy(policy.layers, card)
