"""Searches with Optuna that continue, and that any number of processes share through a storage.

Every process takes the next trial until the storage has enough finished ones. If it is killed, its running trial is
lost. The lock of a journal is one of the operating system, which a killed process leaves unlocked.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from filelock import FileLock
from optuna.distributions import BaseDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from quadpend_train.common.interruptions import progress_bar, signals_wait
from quadpend_train.common.text import brief

SPACES = Path(__file__).with_name("search_spaces")
Space = Mapping[str, BaseDistribution]


def open_study(
    name: str,
    storage: str,
    sampler: Callable[[int], optuna.samplers.BaseSampler],
    seed: int,
    start: Mapping[str, Any],
) -> optuna.Study:
    """Open or create a study, whose first trial has the values `start`.

    The storage is the file of a journal, or the URL of a database such as ``sqlite:///search.db``. Processes that share
    a study need different seeds, so that they propose different trials.
    """
    with quiet():
        try:
            study = optuna.create_study(
                study_name=name,
                storage=storage if "://" in storage else _journal(Path(storage).resolve()),
                load_if_exists=True,
            )
        except Exception as error:  # the database and its driver raise exceptions of many types
            shown = storage.partition("://")[0] + "://…" if "://" in storage else storage  # a URL may have a password
            raise ValueError(f"the storage {shown} cannot be opened: {brief(error)}") from error
        study.sampler = sampler(int(np.random.SeedSequence([seed, len(study.trials)]).generate_state(1)[0]))
        if all(trial.state == TrialState.FAIL for trial in study.trials):
            study.enqueue_trial(dict(start))
    return study


def _journal(file: Path) -> JournalStorage:
    """Return the storage of a file, whose lock another process may hold for at most a minute."""
    file.parent.mkdir(parents=True, exist_ok=True)
    lock: Any = FileLock(file.with_name(f"{file.name}.filelock"), timeout=60.0)
    return JournalStorage(JournalFileBackend(str(file), lock))


def finished(study: optuna.Study) -> list[FrozenTrial]:
    """Return the trials that have ended."""
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def run_trials(
    study: optuna.Study, space: Space, objective: Callable[[optuna.Trial], float], trials: int, progress: bool = True
) -> None:
    """Take trials until the study has enough finished ones, those of all processes together.

    With n processes, up to n - 1 more trials are made.
    """
    with quiet(), progress_bar(total=trials, unit="trial", disable=not progress) as bar:
        while (count := len(finished(study))) < trials:
            bar.update(count - bar.n)
            trial, value = None, None
            state: TrialState | None = TrialState.FAIL
            try:
                with signals_wait():  # so that file and memory of the storage stay the same
                    trial = study.ask(dict(space))
                value, state = objective(trial), None  # a trial whose value is nan fails
            finally:
                if trial is not None:
                    with signals_wait():
                        study.tell(trial, value, state)
        bar.update(trials - bar.n)


@contextmanager
def quiet() -> Iterator[None]:
    """Let Optuna print no line for each trial, and no warning about what a later version will remove."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield
