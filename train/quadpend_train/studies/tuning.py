"""Tuning the classical controllers on the training scenarios, by what policies are compared by.

The score is the penalised RMSE in mm, averaged over the episodes and then over the scenarios of the set ``training``:
survival first, since a fall counts as 1 m, then accuracy. The search (CMA-ES, by Optuna) minimises it, but counts a
fall the worse the earlier it comes, so that it finds its way among gains with which everything falls. What it finds is
rounded to three digits and scored again in episodes that the search has not seen.
"""

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from gymnasium.vector import AutoresetMode
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from quadpend_baselines import Policy
from quadpend_baselines.controllers.registry import CONTROLLER_FACTORIES
from quadpend_baselines.gains import GAINS
from quadpend_baselines.policy.rollout import rollout
from quadpend_gym.core.validation import check_int
from quadpend_gym.tasks import EPISODE_STEPS
from quadpend_train.evaluation.cache import code_stamp
from quadpend_train.evaluation.episodes import TUNING_SEED, EpisodeResults, collect_results
from quadpend_train.scenarios import SETS, find_scenario, scenario_hash

SCORE_SEED = TUNING_SEED + 100_000  # episodes to score what was found in
SCORE_EPISODES = 200

# Lowest and highest value, and where the search begins; on a logarithmic scale, since all are above zero.
Range = tuple[float, float, float]
_LQR = {
    "position": (0.02, 2.0, 0.187),
    "velocity": (0.05, 5.0, 1.55),
    "angle": (0.1, 10.0, 1.42),
    "angle_rate": (0.3, 30.0, 3.46),
    "reach": (0.05, 3.0, 0.5),
    "estimator.rate_noise": (1e-3, 1e-1, 3.76e-3),
    "estimator.force_walk": (0.1, 100.0, 1.22),
    "estimator.bob_force_walk": (1e-3, 1.0, 0.0134),
    "estimator.torque_walk": (1e-3, 10.0, 0.672),
}
_LQI = {
    "position": (0.02, 2.0, 0.417),
    "velocity": (0.05, 5.0, 1.29),
    "angle": (0.1, 10.0, 1.62),
    "angle_rate": (0.3, 30.0, 3.48),
    "reach": (0.05, 3.0, 0.5),
    "integral": (0.01, 3.0, 0.222),
    "integral_limit": (0.02, 2.0, 0.696),
    "estimator.rate_noise": (1e-3, 1e-1, 2.88e-3),
    "estimator.force_walk": (0.1, 100.0, 0.873),
    "estimator.bob_force_walk": (1e-3, 1.0, 4.83e-3),
    "estimator.torque_walk": (1e-3, 10.0, 0.15),
}
SPACES: dict[str, dict[str, Range]] = {
    "adrc-tuned": {
        "horizontal_bandwidth": (2.0, 10.0, 4.0),
        "vertical_bandwidth": (3.0, 15.0, 10.0),
        "damping": (0.5, 1.5, 0.9),
        "mismatch": (0.01, 1.0, 1.0),
        "luenberger.bandwidth": (5.0, 500.0, 15.0),
        "horizontal.bandwidth": (5.0, 500.0, 25.0),
        "horizontal.switching": (1e2, 1e7, 1e5),
        "vertical.bandwidth": (5.0, 500.0, 25.0),
    },
    "lqr": _LQR,
    "lqi": _LQI,
    "flatness": {
        "position_bandwidth": (1.0, 6.0, 4.26),
        "pendulum_bandwidth": (3.0, 15.0, 6.12),
        "attitude_bandwidth": (5.0, 40.0, 13.6),
        "damping": (0.4, 1.3, 0.638),
        "vertical_bandwidth": (3.0, 10.0, 4.19),
        "acceleration": (1.0, 12.0, 3.22),
        "velocity": (0.3, 5.0, 0.936),
        "lean": (0.6, 1.3, 1.03),
        "far_pendulum_bandwidth": (2.5, 8.0, 3.62),
        "far_attitude_bandwidth": (4.0, 20.0, 8.48),
        "near": (0.03, 1.0, 0.157),
        "estimator.rate_noise": (1e-3, 1e-1, 3.44e-3),
        "estimator.force_walk": (0.1, 100.0, 0.535),
        "estimator.bob_force_walk": (1e-3, 1.0, 0.326),
        "estimator.torque_walk": (1e-3, 10.0, 1.76),
    },
    "mppi": {
        "feedback.position": (0.02, 2.0, 0.417),
        "feedback.velocity": (0.05, 5.0, 1.29),
        "feedback.angle": (0.1, 10.0, 1.62),
        "feedback.angle_rate": (0.3, 30.0, 3.48),
        "spread": (0.005, 0.6, 0.05),
        "temperature": (0.01, 3.0, 0.3),
        "estimator.rate_noise": (1e-3, 1e-1, 8e-3),
        "estimator.force_walk": (0.1, 100.0, 0.5),
        "estimator.bob_force_walk": (1e-3, 1.0, 0.3),
        "estimator.torque_walk": (1e-3, 10.0, 0.5),
    },
}


def changed(gains: Any, values: dict[str, float]) -> Any:
    """Gains with some fields changed, ``a.b`` being field b of field a."""
    for path, value in values.items():
        name, _, rest = path.partition(".")
        gains = replace(gains, **{name: changed(getattr(gains, name), {rest: value}) if rest else value})
    return gains


def lost(flights: EpisodeResults) -> float:
    """Mean penalised RMSE in mm, in which a fall at the very start counts twice."""
    share = 1.0 - flights.steps / EPISODE_STEPS
    return 1000.0 * float(np.mean(flights.penalised_rmse + np.where(flights.survived, 0.0, share)))


def score(policy: Policy, episodes: int = SCORE_EPISODES, seed: int = SCORE_SEED) -> dict[str, tuple[float, float]]:
    """Survival (%) and mean penalised RMSE (mm) in each training scenario."""
    fleet: Any = Fleet(episodes)
    flights = collect_results(rollout(policy, fleet, seed), fleet.num_envs)
    parts = (np.split(array, len(SETS["training"])) for array in (flights.survived, flights.penalised_rmse))
    return {
        name: (100.0 * float(survived.mean()), 1000.0 * float(rmse.mean()))
        for name, survived, rmse in zip(SETS["training"], *parts, strict=True)
    }


class Fleet:
    """All training scenarios in the place of one environment, so that a policy is asked once for all of them."""

    def __init__(self, episodes: int) -> None:
        scenarios = [find_scenario(name) for name in SETS["training"]]
        self.envs = [scenario.make_vec(episodes, AutoresetMode.SAME_STEP) for scenario in scenarios]
        self.num_envs = episodes * len(scenarios)

    def reset(self, *, seed: int, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every row; every environment counts up from `seed`."""
        return np.concatenate([env.reset(seed=seed, options=options)[0] for env in self.envs]), {}

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step of every row, with what `rollout` needs of the info."""
        parts = np.split(action, np.cumsum([env.num_envs for env in self.envs])[:-1])
        outcomes = [env.step(part) for env, part in zip(self.envs, parts, strict=True)]
        observation, reward, terminated, truncated = (
            np.concatenate([outcome[i] for outcome in outcomes]) for i in range(4)
        )
        infos = [outcome[4] for outcome in outcomes]
        names = ("tracking_error", "tilt")
        last = [info.get("final_info", info) for info in infos]
        info: dict[str, Any] = {name: np.concatenate([item[name] for item in infos]) for name in names}
        info["final_info"] = {name: np.concatenate([item[name] for item in last]) for name in names}
        return observation, reward, terminated, truncated, info


def search(name: str, trials: int, episodes: int, seed: int, folder: Path) -> optuna.Study:
    """Search the gains of a controller; a search that `folder` holds, by the same code, is gone on with.

    Args:
        name: a key of `SPACES`.
        trials: altogether.
        episodes: in each scenario.
        seed: of the search.
        folder: for the journal of the trials.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = JournalFileBackend(str(folder / f"{name}.log"))
    hashes = [scenario_hash(find_scenario(scenario)) for scenario in SETS["training"]]
    start = {path: first for path, (_, _, first) in SPACES[name].items()}
    with warnings.catch_warnings():  # x0 and sigma0 go with Optuna 6, which is why it must be below
        warnings.simplefilter("ignore", FutureWarning)
        sampler = optuna.samplers.CmaEsSampler(x0=start, sigma0=0.1, seed=seed, warn_independent_sampling=False)
    study = optuna.create_study(
        study_name=json.dumps([name, episodes, seed, SPACES[name], hashes, code_stamp()]),
        storage=JournalStorage(file),
        sampler=sampler,
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(start)
    done = sum(trial.state.is_finished() for trial in study.trials)
    study.optimize(_objective(name, episodes), n_trials=max(trials - done, 0), show_progress_bar=True)
    return study


def _objective(name: str, episodes: int) -> Callable[[optuna.Trial], float]:
    fleet: Any = Fleet(episodes)

    def objective(trial: optuna.Trial) -> float:
        values = {path: trial.suggest_float(path, low, high, log=True) for path, (low, high, _) in SPACES[name].items()}
        policy = CONTROLLER_FACTORIES[name](changed(GAINS[name], values), None)
        return lost(collect_results(rollout(policy, fleet, TUNING_SEED), fleet.num_envs))

    return objective


def tune(name: str, trials: int, episodes: int, seed: int, folder: Path) -> dict[str, Any]:
    """Search and score; what was found is written to `folder`, as ``{name}.json``, and returned.

    Raises:
        ValueError: the controller has nothing to tune, or a number is out of range.
    """
    if name not in SPACES:
        raise ValueError(f"there is no controller {name!r} to tune; there are {', '.join(SPACES)}")
    check_int(trials, "trials", 1)
    check_int(episodes, "episodes", 1)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = search(name, trials, episodes, seed, folder)
    values = {path: float(f"{value:.3g}") for path, value in study.best_params.items()}
    before, after = (
        score(CONTROLLER_FACTORIES[name](gains, None)) for gains in (GAINS[name], changed(GAINS[name], values))
    )
    found = {
        "command": f"quadpend tune {name} --trials {trials} --episodes {episodes} --seed {seed}",
        "gains": values,
        "score": round(float(np.mean([rmse for _, rmse in after.values()])), 2),
        "score of the gains in baselines/quadpend_baselines/gains.py": round(
            float(np.mean([rmse for _, rmse in before.values()])), 2
        ),
        "survival and penalised rmse": {scenario: [round(x, 1) for x in pair] for scenario, pair in after.items()},
    }
    (folder / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found
