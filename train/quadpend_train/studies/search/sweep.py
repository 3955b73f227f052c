"""Search for settings of a learner: each trial is a brief training, scored by the penalised RMSE of its policy.

The score of a trial is that on the card of its policy. The evaluations of the training, in other episodes, decide which
of its policies that is, and whether the trial is stopped since the median of the others is better after the same time.
The first trial has the settings of the start. The sampler is TPE of Optuna; `shared_trials` lets several processes
search. The best policy and that of the start are finally compared in episodes that the search has not used.
"""

import csv
import hashlib
import io
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import optuna
from optuna.distributions import distribution_to_json
from optuna.trial import FrozenTrial, TrialState
from stable_baselines3.common.callbacks import BaseCallback

from quadpend_gym.core.validation import check_int, check_number
from quadpend_gym.scenarios import expand_sets, find_scenario, scenario_hash
from quadpend_train.common.executors import run
from quadpend_train.common.files import toml_text, write_text
from quadpend_train.common.text import brief
from quadpend_train.evaluation.cache import code_hash
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.studies.search import shared_trials
from quadpend_train.studies.search.search_space import Space, start_values, suggest_values, with_values
from quadpend_train.training.run_folder import POLICY
from quadpend_train.training.settings import TrainSettings, to_mapping
from quadpend_train.training.train import CARD_SEED, train
from quadpend_train.training.validation import read_curve, validate

STORAGE, BEST, TABLE, PICTURE = "trials.log", "best.toml", "trials.csv", "sweep.png"
FILES = (BEST, TABLE, PICTURE)
_EVALUATIONS = 64  # of a training with all its timesteps
MOMENTS = 20  # of a trial, evenly spaced in time, at which it is compared with the others
WARM_UP = 5  # of these moments
STARTUP = 4  # finished trials before the first comparison
_REASON = "reason"  # user attribute of a trial
_FINAL_EPISODES, _FINAL_SEED = 200, CARD_SEED + 100_000  # of the comparison with the start


class Sweep(NamedTuple):
    """A search for settings.

    Attributes:
        start: Settings of the first trial.
        space: Ranges of the settings to search for.
        seconds: Duration of the training of a trial, s.
        eval_freq: Timesteps between two evaluations of a trial; 0 for 64 evaluations in the timesteps of `start`.
        seed: Seed of the search; the seed of the trainings is that of `start`.
    """

    start: TrainSettings
    space: Space
    seconds: float
    eval_freq: int = 0
    seed: int = 0

    @property
    def trial_start(self) -> TrainSettings:
        """Settings of the training of the first trial."""
        every = self.eval_freq or max(self.start.total_timesteps // _EVALUATIONS, 1)
        return replace(self.start, max_seconds=self.seconds, eval_freq=every, patience=0)

    @property
    def name(self) -> str:
        """Name of the study: searches that differ in more than the number of trials have different names."""
        space = {name: distribution_to_json(item) for name, item in self.space.items()}
        names = expand_sets((*self.start.scenarios, *self.start.curriculum))
        hashes = [scenario_hash(find_scenario(name)) for name in names]
        key = json.dumps([to_mapping(self.trial_start), space, self.seed, hashes, code_hash()])
        return f"{self.start.algo}-{hashlib.sha256(key.encode()).hexdigest()[:12]}"


def check_options(sweep: Sweep, trials: int, jobs: int) -> None:
    """Check the numbers of a search.

    Raises:
        ValueError: If one is out of range.
    """
    check_number(sweep.seconds, "seconds", 0.1, 1e9, "s")
    check_int(sweep.eval_freq, "eval_freq", 0)


def search(sweep: Sweep, trials: int, out: Path, storage: str | None = None, jobs: int = 1) -> optuna.Study:
    """Make trials until there are enough finished ones, together with those of other processes.

    An interrupted search continues with its finished trials.

    Args:
        sweep: What to search for.
        trials: Number of finished trials, those that were stopped early included.
        out: Folder for the trainings.
        storage: File or URL for `shared_trials.open_storage`; None for a file in `out`.
        jobs: Number of processes.

    Raises:
        ValueError: If a number is out of range, the storage cannot be opened, or the training of no trial ended.
    """
    check_options(sweep, trials, jobs)
    where = storage or str(out / STORAGE)
    study = open_sweep(sweep, where)  # before the other processes, which then need not create it
    if jobs == 1:
        _work(sweep, where, trials, out)
    else:
        calls = {number: partial(_work, sweep, where, trials, out, number == 0) for number in range(jobs)}
        run(calls, jobs, what="process")
    check_completed(study)
    return study


def _tpe(seed: int) -> optuna.samplers.TPESampler:
    return optuna.samplers.TPESampler(seed=seed)


def open_sweep(sweep: Sweep, storage: str) -> optuna.Study:
    """Open or create the study of a search in a storage."""
    with shared_trials.quiet():
        sampler = shared_trials.TrialSampler(_tpe, sweep.seed, start_values(sweep.space, sweep.start))
        pruner = optuna.pruners.MedianPruner(n_startup_trials=STARTUP, n_warmup_steps=WARM_UP)
        return shared_trials.open_study(sweep.name, shared_trials.open_storage(storage), sampler, pruner)


def _work(sweep: Sweep, storage: str, trials: int, out: Path, progress: bool = True) -> None:
    study = open_sweep(sweep, storage)
    if len(shared_trials.finished_trials(study)) < trials:
        _warm_up(sweep.trial_start)
    with shared_trials.quiet():
        shared_trials.run_trials(study, _objective(sweep, out / study.study_name), trials, progress)


def _warm_up(settings: TrainSettings) -> None:
    """Train for one rollout, so that the first trial loses no time by imports and compilation."""
    hybrid = replace(settings.hybrid, imitation_timesteps=0)
    brief_settings = replace(
        settings, hybrid=hybrid, total_timesteps=1, max_seconds=0.0, eval_freq=0, n_eval_episodes=1
    )
    with TemporaryDirectory() as folder:
        train(brief_settings, Path(folder, "run"), progress=False)


def _objective(sweep: Sweep, folder: Path) -> Callable[[optuna.Trial], float]:
    def objective(trial: optuna.Trial) -> float:
        def report(scores: dict[int, float]) -> None:
            for moment, rmse in scores.items():
                trial.report(rmse, moment)
            if trial.should_prune():
                raise optuna.TrialPruned

        run = folder / str(trial.number)
        shutil.rmtree(run, ignore_errors=True)  # of an earlier storage
        try:
            settings = with_values(sweep.trial_start, suggest_values(trial, sweep.space))
            path = train(settings, run, progress=False, callbacks=[Reporting(report, run, sweep.seconds)])
        except (ValueError, FloatingPointError) as error:  # the settings contradict each other, or training diverged
            trial.set_user_attr(_REASON, brief(error))
            raise optuna.TrialPruned(brief(error)) from error
        finally:
            if not (run / POLICY).exists():
                shutil.rmtree(run, ignore_errors=True)
        return float(MlpPolicy.load(path).card["score"]["penalised_rmse"])

    return objective


class Reporting(BaseCallback):
    """Report the best score so far at each moment of a trial, as soon as an evaluation has ended.

    The settings determine how fast training is, so trials are compared after the same time, not at the same timesteps.

    Args:
        report: Function of the scores by the moments that have passed since its last call.
        folder: Folder of the run.
        seconds: Duration of the trial, s.
    """

    def __init__(self, report: Callable[[dict[int, float]], None], folder: Path, seconds: float) -> None:
        super().__init__()
        self.report, self.folder, self.seconds = report, folder, seconds
        self.reported = -1  # latest moment

    def _on_rollout_start(self) -> None:
        scores = read_curve(self.folder)
        moments = [int(MOMENTS * score.seconds / self.seconds) for score in scores]
        if not scores or moments[-1] <= self.reported:
            return
        passed: dict[int, float] = {}
        for moment in range(self.reported + 1, moments[-1] + 1):
            known = [score for score, at in zip(scores, moments, strict=True) if at <= moment]
            passed[moment] = min(score.penalised_rmse for score in known or scores)
        self.reported = moments[-1]
        self.report(passed)

    def _on_step(self) -> bool:
        return True


def completed(study: optuna.Study) -> list[FrozenTrial]:
    """Return the trials whose training came to its end."""
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def check_completed(study: optuna.Study) -> None:
    """Check that the training of a trial came to its end.

    Raises:
        ValueError: If none did.
    """
    if not completed(study):
        reasons = {str(trial.user_attrs.get(_REASON, "")) for trial in study.get_trials(deepcopy=False)} - {""}
        raise ValueError(f"no training of the sweep came to its end: {'; '.join(sorted(reasons)) or 'see above'}")


def advice(study: optuna.Study) -> str:
    """Return what to change if the search could not compare its trials; empty otherwise."""
    if len(values := [trial.value for trial in completed(study)]) > 1 and len(set(values)) == 1:
        return "All trials have the same score, so the search is blind: give more --seconds, or an easier scenario."
    return ""


def start_trial(study: optuna.Study, sweep: Sweep) -> FrozenTrial | None:
    """Return the trial with the settings of the start, None if no process has finished it."""
    start = start_values(sweep.space, sweep.start)
    return next((trial for trial in completed(study) if trial.params == start), None)


def final_scores(study: optuna.Study, sweep: Sweep, out: Path) -> dict[str, float]:
    """Return the penalised RMSE (m) of start and best trial in episodes that the search has not used.

    Trials that other machines made are left out.
    """
    settings, scores = replace(sweep.start, n_eval_episodes=_FINAL_EPISODES), {}
    for name, trial in {"start": start_trial(study, sweep), "best": study.best_trial}.items():
        path = out / study.study_name / str(trial.number) / POLICY if trial else None
        if path and path.is_file():
            scores[name] = validate(MlpPolicy.load(path), settings, _FINAL_SEED)[1]
    return scores


def summary(study: optuna.Study, sweep: Sweep, scores: Mapping[str, float]) -> list[str]:
    """Return sentences about the best trial and the start.

    Args:
        study: The finished search.
        sweep: What was searched for.
        scores: Scores of `final_scores`.
    """
    count = len(shared_trials.finished_trials(study))
    lines = [f"Best of {count} trials of {sweep.seconds:g} s, trial {study.best_trial.number}:"]
    lines[0] += f" penalised RMSE {1e3 * study.best_value:.1f} mm."
    if (first := start_trial(study, sweep)) is not None:
        lines.append(f"The settings of the start: {1e3 * (first.value or 0.0):.1f} mm.")
    if len(scores) == 2:
        lines.append(
            f"In {_FINAL_EPISODES} episodes of each scenario that the search has not used:"
            f" {1e3 * scores['best']:.1f} mm instead of {1e3 * scores['start']:.1f} mm."
        )
    return lines


def best_settings(study: optuna.Study, sweep: Sweep, lines: Sequence[str]) -> str:
    """Return the settings of the best trial as a settings file with comments, without the limits of the trials."""
    comments = "".join(f"# {line}\n" for line in lines)
    return comments + toml_text(to_mapping(with_values(sweep.start, study.best_params)))


def table(study: optuna.Study, sweep: Sweep) -> str:
    """Return a table of all trials as CSV, with scores in m."""
    lines = io.StringIO(newline="")
    writer = csv.writer(lines)
    writer.writerow(["trial", "state", "penalised_rmse", "seconds", *sweep.space, "reason"])
    for trial in study.get_trials(deepcopy=False):
        seconds = round(trial.duration.total_seconds(), 1) if trial.duration else ""
        values = [trial.params.get(name, "") for name in sweep.space]
        reason = trial.user_attrs.get(_REASON, "")
        writer.writerow([trial.number, trial.state.name.lower(), trial.value, seconds, *values, reason])
    return lines.getvalue()


def write_results(study: optuna.Study, sweep: Sweep, out: Path) -> list[str]:
    """Write the settings of the best trial and the table of all trials, and return sentences about them."""
    lines = summary(study, sweep, final_scores(study, sweep, out))
    write_text(out / BEST, best_settings(study, sweep, lines))
    write_text(out / TABLE, table(study, sweep))
    return lines
