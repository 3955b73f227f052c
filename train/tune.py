"""Tuning the classical controllers on the training scenarios, with the learners' own objective.

The score is the penalised RMSE in mm, averaged over the episodes and then over the scenarios of the set ``training``:
survival first, since a fall counts as 1 m, then accuracy. The search (Optuna's TPE) minimises it, but counts a fall the
worse the earlier it comes, so that it finds its way among gains with which everything falls. What it finds is rounded
to three digits and scored again in episodes that the search has not seen.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from baselines import Policy
from baselines.controllers import MAKERS
from baselines.gains import GAINS
from quadpend_gym.records import whole
from train.flights import VALIDATION_SEED, Flights, fly
from train.scenarios import SETS

SCORE_SEED = VALIDATION_SEED + 100_000  # episodes to score what was found in
SCORE_EPISODES = 200

_ESTIMATOR = {
    "estimator.rate_noise": (1e-3, 1e-1),
    "estimator.force_walk": (0.1, 100.0),
    "estimator.bob_force_walk": (1e-3, 1.0),
    "estimator.torque_walk": (1e-3, 10.0),
}
_LQR = {
    "position": (0.02, 2.0),
    "velocity": (0.05, 5.0),
    "angle": (0.1, 10.0),
    "angle_rate": (0.3, 30.0),
    **_ESTIMATOR,
}
# What is searched, and between which bounds; on a logarithmic scale, since all are above zero.
SPACES: dict[str, dict[str, tuple[float, float]]] = {
    "adrc-tuned": {
        "horizontal_bandwidth": (2.0, 10.0),
        "vertical_bandwidth": (3.0, 15.0),
        "damping": (0.5, 1.5),
        "mismatch": (0.01, 1.0),
        "luenberger.bandwidth": (5.0, 500.0),
        "horizontal.bandwidth": (5.0, 500.0),
        "horizontal.switching": (1e2, 1e7),
        "vertical.bandwidth": (5.0, 500.0),
    },
    "lqr": _LQR,
    "lqi": {**_LQR, "integral": (0.01, 3.0), "integral_limit": (0.02, 2.0)},
    "flatness": {
        "position_bandwidth": (1.0, 6.0),
        "pendulum_bandwidth": (3.0, 15.0),
        "attitude_bandwidth": (5.0, 40.0),
        "damping": (0.4, 1.3),
        "vertical_bandwidth": (3.0, 10.0),
        "acceleration": (1.0, 12.0),
        "velocity": (0.3, 5.0),
        "lean": (0.6, 1.3),
        "far_pendulum_bandwidth": (2.5, 8.0),
        "far_attitude_bandwidth": (4.0, 20.0),
        "near": (0.03, 1.0),
        **_ESTIMATOR,
    },
}


def changed(gains: Any, values: dict[str, float]) -> Any:
    """Gains with some fields changed, ``a.b`` being field b of field a."""
    for path, value in values.items():
        name, _, rest = path.partition(".")
        gains = replace(gains, **{name: changed(getattr(gains, name), {rest: value}) if rest else value})
    return gains


def read(gains: Any, path: str) -> float:
    """The field ``a.b`` of gains."""
    for name in path.split("."):
        gains = getattr(gains, name)
    return float(gains)


def lost(flights: Flights) -> float:
    """Mean penalised RMSE in mm, in which a fall at the very start counts twice."""
    share = 1.0 - flights.steps / 1000.0
    return 1000.0 * float(np.mean(flights.penalised_rmse + np.where(flights.survived, 0.0, share)))


def score(policy: Policy, episodes: int = SCORE_EPISODES, seed: int = SCORE_SEED) -> dict[str, tuple[float, float]]:
    """Survival (%) and mean penalised RMSE (mm) in each training scenario."""
    flown = {name: fly([policy], name, episodes, seed) for name in SETS["training"]}
    return {
        name: (100.0 * float(flights.survived.mean()), 1000.0 * float(flights.penalised_rmse.mean()))
        for name, flights in flown.items()
    }


def search(name: str, trials: int, episodes: int, seed: int, folder: Path) -> optuna.Study:
    """Search the gains of a controller; what is in `folder` already is gone on with.

    Args:
        name: a key of `SPACES`.
        trials: altogether.
        episodes: in each scenario.
        seed: of the search.
        folder: for the journal of the trials.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = optuna.storages.journal.JournalFileBackend(str(folder / f"{name}.log"))
    study = optuna.create_study(
        study_name=f"{name}, {episodes} episodes, seed {seed}",
        storage=optuna.storages.JournalStorage(file),
        load_if_exists=True,
    )
    done = [trial for trial in study.trials if trial.state.is_finished()]
    if not study.trials:
        study.enqueue_trial({path: read(GAINS[name], path) for path in SPACES[name]})
    # Its own seed for each resumption, lest it repeat itself.
    study.sampler = optuna.samplers.TPESampler(seed=seed + len(done), multivariate=True, n_startup_trials=20)
    study.pruner = optuna.pruners.MedianPruner(n_startup_trials=20, n_warmup_steps=0)
    study.optimize(_objective(name, episodes), n_trials=max(trials - len(done), 0), show_progress_bar=True)
    return study


def _objective(name: str, episodes: int) -> Callable[[optuna.Trial], float]:
    order = sorted(SETS["training"], key=lambda scenario: not scenario.startswith("t"))  # the hard ones first

    def objective(trial: optuna.Trial) -> float:
        values = {path: trial.suggest_float(path, low, high, log=True) for path, (low, high) in SPACES[name].items()}
        policy = MAKERS[name](changed(GAINS[name], values), None)
        total = 0.0
        for number, scenario in enumerate(order, 1):
            total += lost(fly([policy], scenario, episodes, VALIDATION_SEED))
            trial.report(total / number, number)
            if trial.should_prune():
                raise optuna.TrialPruned
        return total / len(order)

    return objective


def tune(name: str, trials: int, episodes: int, seed: int, folder: Path) -> dict[str, Any]:
    """Search and score; what was found is written to `folder`, as ``{name}.json``, and returned.

    Raises:
        ValueError: the controller has nothing to tune, or a number is out of range.
    """
    if name not in SPACES:
        raise ValueError(f"there is no controller {name!r} to tune; there are {', '.join(SPACES)}")
    whole(trials, "trials", 1)
    whole(episodes, "episodes", 1)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = search(name, trials, episodes, seed, folder)
    values = {path: float(f"{value:.3g}") for path, value in study.best_params.items()}
    before, after = (score(MAKERS[name](gains, None)) for gains in (GAINS[name], changed(GAINS[name], values)))
    found = {
        "command": f"quadpend tune {name} --trials {trials} --episodes {episodes} --seed {seed}",
        "gains": values,
        "score": round(float(np.mean([rmse for _, rmse in after.values()])), 2),
        "score of the gains in baselines/gains.py": round(float(np.mean([rmse for _, rmse in before.values()])), 2),
        "survival and penalised rmse": {scenario: [round(x, 1) for x in pair] for scenario, pair in after.items()},
    }
    (folder / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found
