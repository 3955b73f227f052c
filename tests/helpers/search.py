"""A search of two parameters that several processes share."""

import math
import sys
import time
import warnings
from pathlib import Path

import optuna

from quadpend_train.studies.search.shared_trials import TrialSampler, open_storage, open_study, quiet, run_trials

START = {"x": 1.0, "y": 10.0}


def distance(trial: optuna.Trial) -> float:
    """The squared distance to (3, 0.7) on logarithmic scales."""
    x, y = (trial.suggest_float(name, 0.01, 100.0, log=True) for name in START)
    return math.log(x / 3.0) ** 2 + 10.0 * math.log(y / 0.7) ** 2


def sampler(seed: int = 0) -> TrialSampler:
    """CMA-ES as in `quadpend tune`."""

    def make(number: int) -> optuna.samplers.CmaEsSampler:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            return optuna.samplers.CmaEsSampler(x0=START, sigma0=0.1, seed=number, warn_independent_sampling=False)

    return TrialSampler(make, seed, START)


def open_test_study(storage: str) -> optuna.Study:
    """The study of the tests."""
    with quiet():
        return open_study("test", open_storage(storage), sampler())


def work(storage: str, trials: int, seconds: float, begun: Path, processes: int) -> None:
    """Take trials that last some seconds; a trial writes an empty file, and waits until each process has done so."""

    def objective(trial: optuna.Trial) -> float:
        value = distance(trial)
        begun.touch()
        while len(list(begun.parent.glob("begun*"))) < processes:
            time.sleep(0.01)
        time.sleep(seconds)
        return value

    run_trials(open_test_study(storage), objective, trials, progress=False)


if __name__ == "__main__":
    work(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]), int(sys.argv[5]))
