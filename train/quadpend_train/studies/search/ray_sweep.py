"""Ray Tune as the engine of a sweep: its trials run on the machines of a Ray cluster.

Search space, sampler and storage are those of `quadpend_train.studies.search.sweep`, so a sweep can change its engine.
This process proposes the trials. Ray Tune stops them by its own rule of the median; a stopped trial counts as complete,
with its best score so far.
"""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import optuna

import quadpend_baselines
import quadpend_gym
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.studies.search.search_space import with_values
from quadpend_train.studies.search.shared_trials import finished_trials, open_storage, quiet
from quadpend_train.studies.search.sweep import (
    MOMENTS,
    STARTUP,
    STORAGE,
    WARM_UP,
    Reporting,
    Sweep,
    check_completed,
    open_sweep,
)
from quadpend_train.training.train import train

_METRIC, _MOMENT = "penalised_rmse", "moment"


def search(sweep: Sweep, trials: int, out: Path, storage: str | None, cluster: str) -> optuna.Study:
    """Make trials on a Ray cluster until there are enough finished ones.

    Args:
        sweep: What to search for.
        trials: Number of finished trials.
        out: Folder for the files of Ray Tune.
        storage: File or URL for `open_storage`, which only this process opens; None for a file in `out`.
        cluster: Address for `ray.init`: ``auto``, ``local`` or ``ray://host:port``.

    Raises:
        ModuleNotFoundError: If Ray is not installed.
        ValueError: If the training of no trial ended.
    """
    import ray
    from ray import tune
    from ray.tune.schedulers import MedianStoppingRule
    from ray.tune.search.optuna import OptunaSearch

    where = storage or str(out / STORAGE)
    study = open_sweep(sweep, where)
    missing = trials - len(finished_trials(study))
    if missing <= 0:
        return study
    files = (quadpend_gym.__file__, quadpend_baselines.__file__)
    packages = [*(str(Path(str(file)).parent) for file in files), str(Path(__file__).parents[2])]
    ray.init(address=cluster, runtime_env={"py_modules": packages}, ignore_reinit_error=True)
    try:
        with quiet():
            searcher = OptunaSearch(
                dict(sweep.space), _METRIC, "min", None, study.sampler, study.study_name, open_storage(where)
            )
            rule = MedianStoppingRule(_MOMENT, _METRIC, "min", grace_period=WARM_UP, min_samples_required=STARTUP)
            tune.Tuner(
                tune.with_resources(partial(_train, sweep=sweep), {"cpu": sweep.start.num_threads}),
                tune_config=tune.TuneConfig(search_alg=searcher, scheduler=rule, num_samples=missing),
                run_config=tune.RunConfig(study.study_name, str(out.resolve()), verbose=1),
            ).fit()
    finally:
        ray.shutdown()
    check_completed(study)
    return study


def _train(values: dict[str, Any], sweep: Sweep) -> None:
    """Train with the values of a trial, in a process of the cluster."""
    from ray import tune

    def report(scores: dict[int, float]) -> None:
        for moment, rmse in scores.items():
            tune.report({_METRIC: rmse, _MOMENT: moment})

    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        callbacks = [Reporting(report, run, sweep.seconds)]
        policy = MlpPolicy.load(train(with_values(sweep.trial_start, values), run, progress=False, callbacks=callbacks))
        report({MOMENTS: policy.card["score"]["penalised_rmse"]})
