"""Trials of a search that any number of processes share through a storage of Optuna.

Every process takes the next trial until the storage has enough finished ones. A process may start or end at any time.
If it is killed, only its running trial is lost; the next process on the same machine makes this trial again.
"""

import os
import random
import re
import socket
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import FrozenTrial, TrialState
from tqdm.auto import tqdm

from quadpend_train.common.files import writable_file
from quadpend_train.common.text import brief

FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)
_PROCESS, _REPEATED = "process", "repeated"  # user attributes of a trial
_SQLITE_SECONDS = 60.0  # for which a process waits while another one writes


class TrialSampler(BaseSampler):
    """A sampler whose trial 0 is the start, and whose random numbers depend on a seed and the number of the trial only.

    So processes with the same seed propose different trials.

    Args:
        make: Function that returns the sampler of a trial for its seed.
        seed: Seed of the search.
        start: Values of the parameters of trial 0.
    """

    def __init__(self, make: Callable[[int], BaseSampler], seed: int, start: Mapping[str, Any]) -> None:
        self._make, self._seed, self.start = make, seed, start
        self._sampler = make(seed)

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Make the sampler of a trial."""
        self._sampler = self._make(int(np.random.SeedSequence([self._seed, trial.number]).generate_state(1)[0]))
        self._sampler.before_trial(study, trial)

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Return the parameters that are sampled together."""
        if trial.number == 0:
            return {}
        return self._sampler.infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Return values of the parameters that are sampled together."""
        return self._sampler.sample_relative(study, trial, search_space)

    def sample_independent(
        self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """Return a value of one parameter."""
        if trial.number == 0:
            return self.start[param_name]
        return self._sampler.sample_independent(study, trial, param_name, param_distribution)


def is_url(storage: str) -> bool:
    """Return whether a storage is the URL of a database and not a file."""
    return "://" in storage


def describe_storage(storage: str) -> str:
    """Return the name of a storage without a password."""
    return re.sub(r"(://[^:/@]*):.*@", r"\1:***@", storage)


def open_storage(storage: str) -> BaseStorage:
    """Open or create a storage.

    Args:
        storage: File of a journal, or URL of a database such as ``sqlite:///search.db``.

    Raises:
        ValueError: If it cannot be opened, or is damaged.
    """
    try:
        if is_url(storage):
            return _open_database(storage)
        path = writable_file(Path(storage), "storage").resolve()
        return JournalStorage(JournalFileBackend(str(path), JournalFileOpenLock(str(path))))
    except ValueError as error:
        if str(error).startswith(("storage must", "the folder of storage")):
            raise
        raise ValueError(_refusal(storage, error)) from error
    except Exception as error:  # the database and its driver raise exceptions of many types
        raise ValueError(_refusal(storage, error)) from error


def _open_database(url: str) -> RDBStorage:
    options = {"connect_args": {"timeout": _SQLITE_SECONDS}} if url.startswith("sqlite") else None
    with suppress(Exception):
        return RDBStorage(url, engine_kwargs=options)
    time.sleep(random.uniform(0.5, 2.0))  # another process may be creating the tables
    return RDBStorage(url, engine_kwargs=options)


def _refusal(storage: str, error: Exception) -> str:
    kind = storage.partition("://")[0] + "://…" if is_url(storage) else storage
    return (
        "storage must be a file of Optuna's journal or the URL of a database, such as sqlite:///search.db, not"
        f" {kind}: {brief(error)}"
    )


def open_study(
    name: str,
    storage: BaseStorage,
    sampler: TrialSampler,
    pruner: optuna.pruners.BasePruner | None = None,
) -> optuna.Study:
    """Open or create a study, and queue the lost trials of processes that were killed."""
    study = optuna.create_study(
        study_name=name,
        storage=storage,
        sampler=sampler,
        pruner=pruner or optuna.pruners.NopPruner(),
        load_if_exists=True,
    )
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        if _is_lost(trial):
            storage.set_trial_user_attr(trial._trial_id, _REPEATED, True)
            study.enqueue_trial(trial.params if trial.number else dict(sampler.start))
    return study


def _is_lost(trial: FrozenTrial) -> bool:
    """Return whether a process of this machine has ended before it finished the trial."""
    host, process = trial.user_attrs.get(_PROCESS, ("", 0))
    if host != socket.gethostname() or trial.user_attrs.get(_REPEATED):
        return False
    if process == os.getpid():
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # the process of another user
        return False
    return False


def finished_trials(study: optuna.Study) -> list[FrozenTrial]:
    """Return the finished trials in the order of their numbers."""
    return study.get_trials(deepcopy=False, states=FINISHED)


def run_trials(
    study: optuna.Study, objective: Callable[[optuna.Trial], float], trials: int, progress: bool = True
) -> None:
    """Take trials until the study has enough finished ones, those of all processes together.

    Args:
        study: Study of `open_study`.
        objective: Function that returns the value of a trial, or raises `optuna.TrialPruned`.
        trials: Number of finished trials. With n processes, up to n - 1 more trials are made.
        progress: Whether to show a progress bar.
    """

    def numbered(trial: optuna.Trial) -> float:
        trial.set_user_attr(_PROCESS, (socket.gethostname(), os.getpid()))
        return objective(trial)

    with tqdm(total=trials, unit="trial", disable=not progress) as bar:
        while True:
            done = finished_trials(study)
            bar.update(min(len(done), trials) - bar.n)
            if values := [
                trial.value for trial in done if trial.state == TrialState.COMPLETE and trial.value is not None
            ]:
                bar.set_postfix_str(f"best {min(values):.4g}")
            if len(done) >= trials:
                return
            study.optimize(numbered, n_trials=1)


@contextmanager
def quiet() -> Iterator[None]:
    """Let Optuna print no line for each trial, and no warning about arguments that a later version will remove."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield
