"""Search for settings of a learner: each trial is a brief training, scored by the penalised RMSE of its policy.

The score of a trial is that on the card of its policy. The evaluations of the training, in other episodes, decide which
of its policies that is, and whether the trial is stopped since the median of the others is better after the same time.
The first trial has the settings of the start. The sampler is TPE of Optuna.

A search space is a settings file with a range or a list of values in place of a value. A range is a table
``{low = 1e-4, high = 1e-2, log = true}``. The space is extended to include the settings of the start.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    distribution_to_json,
)
from optuna.trial import FrozenTrial, TrialState

from quadpend_gym.core.files import read_mapping
from quadpend_train.common.executors import run as run_calls
from quadpend_train.common.files import write_text
from quadpend_train.common.text import brief
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.search.shared import SPACES, Space, finished, flat, open_study, run_trials, signals_wait
from quadpend_train.training.callbacks import RolloutCallback
from quadpend_train.training.settings import TrainSettings, to_mapping, with_values
from quadpend_train.training.train import POLICY, train

BEST, TABLE, PICTURE = "best.json", "trials.csv", "sweep.png"
FILES = (BEST, TABLE, PICTURE)
_EVALUATIONS = 64  # of a training with all its timesteps
MOMENTS = 20  # of a trial, evenly spaced in time, at which it is compared with the others
_WARM_UP, _STARTUP = 5, 4  # moments and finished trials before the first comparison


def read_space(path: Path | None, start: TrainSettings) -> tuple[dict[str, BaseDistribution], dict[str, Any]]:
    """Return the distributions and the values at the start by the path of the setting, such as ``ppo.n_epochs``.

    Without a file, the space is that of the algorithm in this package. A setting that the start leaves to the algorithm
    starts with the lowest or the first value.
    """
    file, known = path or SPACES / f"{start.algo}.toml", dict(flat(to_mapping(start)))
    if not file.is_file():
        raise ValueError(f"there is no search space {file}: give one with --space")
    read = {name: _distribution(name, given, known.get(name)) for name, given in flat(read_mapping(file))}
    for name, (found, _) in read.items():
        for value in found.choices if isinstance(found, CategoricalDistribution) else (found.low, found.high):
            proposed(start, {name: value})
    return {name: found for name, (found, _) in read.items()}, {name: first for name, (_, first) in read.items()}


def _distribution(
    name: str, given: Any, start: Any
) -> tuple[CategoricalDistribution | FloatDistribution | IntDistribution, Any]:
    """Return a distribution that includes the value at the start, and this value."""
    if isinstance(given, list) and given:
        choices, first = [_choice(value) for value in given], _choice(given[0] if start is None else start)
        return CategoricalDistribution(choices if first in choices else [*choices, first]), first
    if not isinstance(given, dict) or not {"low", "high"} <= given.keys() <= {"low", "high", "log"}:
        raise ValueError(f"{name} must be {{low = …, high = …, log = …}} or a list, not {given!r}")
    first = start if isinstance(start, int | float) else given["low"]
    low, high = min(given["low"], first), max(given["high"], first)
    kind = FloatDistribution if isinstance(low, float) or isinstance(high, float) else IntDistribution
    return kind(low, high, log=given.get("log", False)), first


def _choice(value: Any) -> Any:
    """Return a value that Optuna can store: lists become JSON."""
    return json.dumps(value) if isinstance(value, list | tuple) else value


def proposed(start: TrainSettings, values: Mapping[str, Any]) -> TrainSettings:
    """Return settings with the values of a trial."""
    lists = {name: json.loads(value) for name, value in values.items() if isinstance(value, str) and value[:1] == "["}
    return with_values(start, {**values, **lists})


class Sweep(NamedTuple):
    """A search for settings."""

    start: TrainSettings  # of the first trial
    space: Space  # distributions of the settings to search for
    values: Mapping[str, Any]  # their values at the start
    seconds: float  # duration of the training of a trial, s
    out: Path  # folder for the trainings
    storage: str  # file or URL for `open_study`
    seed: int = 0  # of the search; the seed of the trainings is that of `start`

    @property
    def trial_start(self) -> TrainSettings:
        """Settings of the training of the first trial."""
        every = max(self.start.total_timesteps // _EVALUATIONS, 1)
        return replace(self.start, max_seconds=self.seconds, eval_freq=every)

    @property
    def name(self) -> str:
        """Name of the study: searches for other settings have other names."""
        space = {name: distribution_to_json(item) for name, item in self.space.items()}
        key = json.dumps([to_mapping(self.trial_start), space])
        return f"{self.start.algo}-{hashlib.sha256(key.encode()).hexdigest()[:12]}"

    def open(self, worker: int = 0) -> optuna.Study:
        """Open or create the study in the storage."""
        pruner = optuna.pruners.MedianPruner(n_startup_trials=_STARTUP, n_warmup_steps=_WARM_UP)
        seed = self.seed + 1_000_003 * worker
        return open_study(
            self.name, self.storage, lambda own: optuna.samplers.TPESampler(seed=own), seed, self.values, pruner
        )

    def folder(self, trial: optuna.Trial | FrozenTrial) -> Path:
        """Return the run folder of a trial."""
        return self.out / self.name / str(trial.number)


def search(sweep: Sweep, trials: int, jobs: int = 1) -> optuna.Study:
    """Make trials in `jobs` processes until `trials` are finished, together with those of other processes."""
    study = sweep.open()  # before the other processes, which then need not create it
    if len(finished(study)) < trials:
        run_calls({worker: partial(_work, sweep, trials, worker) for worker in range(jobs)}, jobs, what="process")
    if not _complete(study):
        reasons = {str(trial.user_attrs["reason"]) for trial in study.trials if "reason" in trial.user_attrs}
        raise ValueError(f"no training of the sweep came to its end: {'; '.join(sorted(reasons)) or 'see above'}")
    return study


def _complete(study: optuna.Study) -> list[FrozenTrial]:
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def _work(sweep: Sweep, trials: int, worker: int) -> None:
    hybrid = replace(sweep.start.hybrid, imitation_timesteps=0)
    with TemporaryDirectory() as folder:  # one rollout, so that the first trial loses no time by compilation
        train(replace(sweep.start, hybrid=hybrid, total_timesteps=1), Path(folder, "run"), progress=False)
    run_trials(sweep.open(worker), sweep.space, partial(_score, sweep), trials, progress=worker == 0)


def _score(sweep: Sweep, trial: optuna.Trial) -> float:
    """Train with the values of a trial, and return the penalised RMSE of its policy."""
    run = sweep.folder(trial)
    shutil.rmtree(run, ignore_errors=True)  # of an earlier storage
    try:
        settings = proposed(sweep.trial_start, trial.params)
        path = train(settings, run, progress=False, callbacks=[_Reporting(trial, sweep.seconds)])
    except (ValueError, FloatingPointError) as error:  # the settings contradict each other, or training diverged
        with signals_wait():
            trial.set_user_attr("reason", brief(error))
        raise optuna.TrialPruned(brief(error)) from error
    finally:
        if not (run / POLICY).exists():
            shutil.rmtree(run, ignore_errors=True)
    return float(MlpPolicy.load(path).card["score"]["penalised_rmse"])


class _Reporting(RolloutCallback):
    """Report the best score so far at each moment of a trial, as soon as an evaluation has ended.

    The settings determine how fast training is, so trials are compared after the same time, not at the same timesteps.
    """

    def __init__(self, trial: optuna.Trial, seconds: float) -> None:
        super().__init__()
        self.trial, self.seconds, self.reported = trial, seconds, -1

    @signals_wait()
    def _on_rollout_start(self) -> None:
        scores: Any = self.model.scores  # type: ignore[attr-defined]  # of `EvaluationCallback`
        now = int(MOMENTS * scores[-1].seconds / self.seconds) if scores else -1
        if now > self.reported:
            self.trial.report(min(score.penalised_rmse for score in scores), now)
            self.reported = now
            if self.trial.should_prune():
                raise optuna.TrialPruned


def write_results(study: optuna.Study, sweep: Sweep) -> list[str]:
    """Write the settings of the best trial and the table of all trials, and return sentences about them."""
    best = study.best_trial
    first = next((trial for trial in _complete(study) if trial.params == sweep.values), None)
    lines = [
        f"Best of {len(finished(study))} trials of {sweep.seconds:g} s, trial {best.number}: penalised RMSE"
        f" {1e3 * study.best_value:.1f} mm."
    ]
    if first:
        lines[0] += f" The settings of the start: {1e3 * (first.value or 0.0):.1f} mm."
    if len(_complete(study)) > 1 and len({trial.value for trial in _complete(study)}) == 1:
        lines.append(
            "All trials have the same score, so the search is blind: give more --seconds, or an easier scenario."
        )
    settings = proposed(sweep.start, best.params)
    write_text(sweep.out / BEST, json.dumps(to_mapping(settings), indent=1) + "\n")
    table = study.trials_dataframe(("number", "state", "value", "duration", "params", "user_attrs"))
    write_text(sweep.out / TABLE, table.to_csv(index=False))
    return lines
