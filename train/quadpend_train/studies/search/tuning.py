"""Tune the gains of the classical controllers by the metric of the comparisons.

The score is the penalised RMSE in mm, averaged over the episodes and then over the scenarios, by default those of the
set ``training``. The scenarios must have the same nominal simulation, for which the controllers are designed. A fall
counts as 1 m, the largest possible value of an episode. The search (CMA-ES of Optuna) minimises a loss that adds a
larger term for an earlier fall. So the search also makes progress between gains with which every episode ends in a
fall. The best gains are rounded to three digits and scored in episodes that the search has not used.
"""

import hashlib
import json
import shlex
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from gymnasium.vector import VectorEnv

from quadpend_baselines import Policy
from quadpend_baselines.controllers.hanging import Hanging, mirror_simulation
from quadpend_baselines.controllers.vehicle_gains import gains_for, read_gain, replace_gains
from quadpend_baselines.policy.rollout import rollout
from quadpend_baselines.registry import CONTROLLER_FACTORIES
from quadpend_gym import Simulation
from quadpend_gym.core.files import read_mapping
from quadpend_gym.core.validation import suggest
from quadpend_gym.scenarios import HELD_OUT, Scenario, expand_sets, find_scenario, scenario_hash, split_changes
from quadpend_train.common.files import write_text
from quadpend_train.evaluation.cache import code_hash
from quadpend_train.evaluation.episodes import TUNING_SEED, EpisodeResults, collect_results, pendulum_arm
from quadpend_train.studies.search.shared_trials import (
    TrialSampler,
    describe_storage,
    open_storage,
    open_study,
    quiet,
    run_trials,
)
from quadpend_train.training.environment import concatenate_scenarios

SCORE_SEED = TUNING_SEED + 100_000  # seed of the first episode of the score
SCORE_EPISODES = 200
SCENARIOS = ("training",)  # default

# Lowest value, highest value and initial value of a gain. The search uses a logarithmic scale, so all are above zero.
SearchRange = tuple[float, float, float]
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
SEARCH_SPACES: dict[str, dict[str, SearchRange]] = {
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
    "swing-up": {
        "damp": (0.3, 6.0, 1.5),
        "lead": (0.02, 0.3, 0.08),
        "position": (0.2, 6.0, 1.0),
        "velocity": (0.4, 6.0, 1.5),
        "lean": (0.3, 1.2, 0.6),
        "attitude_bandwidth": (7.0, 30.0, 14.0),
        "vertical_bandwidth": (1.5, 8.0, 3.0),
        "damping": (0.5, 1.5, 0.8),
        "catch": (0.1, 0.8, 0.35),
        "catch_height": (0.5, 0.95, 0.8),
        "rest_scale": (0.5, 3.0, 1.0),
    },
}


def search_space(name: str, simulation: Simulation) -> dict[str, SearchRange]:
    """Return the ranges of the search; those of rigid vehicles are relative to the present gains of the vehicle."""
    ranges = SEARCH_SPACES[name]
    if not simulation.is_rigid:
        return ranges
    gains = gains_for(name, simulation)
    now = {path: read_gain(gains, path) for path in ranges}
    return {path: (now[path] * low / at, now[path] * high / at, now[path]) for path, (low, high, at) in ranges.items()}


def loss(results: EpisodeResults) -> float:
    """Return the mean penalised RMSE in mm, with up to 1 m added for each fall, the more the earlier it is."""
    remaining = 1.0 - results.steps / results.error.shape[-1]
    return 1000.0 * float(np.mean(results.penalised_rmse + np.where(results.survived, 0.0, remaining)))


def score(
    policy: Policy, episodes: int = SCORE_EPISODES, seed: int = SCORE_SEED, scenarios: Sequence[str] = SCENARIOS
) -> dict[str, tuple[float, float]]:
    """Return survival (%) and mean penalised RMSE (mm) in each scenario."""
    results = run_training_scenarios(policy, training_scenarios(episodes, scenarios), seed, scenarios)
    names = expand_sets(scenarios)
    parts = (np.split(array, len(names)) for array in (results.survived, results.penalised_rmse))
    return {
        name: (100.0 * float(survived.mean()), 1000.0 * float(rmse.mean()))
        for name, survived, rmse in zip(names, *parts, strict=True)
    }


def training_scenarios(episodes: int, scenarios: Sequence[str] = SCENARIOS) -> VectorEnv[Any, Any, Any]:
    """Return one vector environment with `episodes` sub-environments of each scenario."""
    found = _find_all(scenarios)
    return concatenate_scenarios(found, episodes * len(found))


def _find_all(scenarios: Sequence[str]) -> list[Scenario]:
    return [find_scenario(name) for name in expand_sets(scenarios)]


def run_training_scenarios(
    policy: Policy, env: VectorEnv[Any, Any, Any], seed: int, scenarios: Sequence[str] = SCENARIOS
) -> EpisodeResults:
    """Run a policy through the same seeds in every scenario.

    Args:
        policy: Policy to run.
        env: Environment of `training_scenarios`.
        seed: Seed of the first episode of each scenario.
        scenarios: Names of the scenarios and of sets of scenarios.

    Returns:
        Results of shape (scenarios · episodes,), the episodes of one scenario after those of another.
    """
    found = _find_all(scenarios)
    episodes = env.num_envs // len(found)
    seeds = [seed + episode for _ in found for episode in range(episodes)]
    lengths = np.repeat([scenario.steps for scenario in found], episodes)
    return collect_results(rollout(policy, env, seeds), lengths, found[0].simulation.period, pendulum_arm(found[0]))


def search(
    name: str,
    trials: int,
    episodes: int,
    seed: int,
    folder: Path,
    scenarios: Sequence[str] = SCENARIOS,
    storage: str | None = None,
) -> optuna.Study:
    """Search for gains of a controller, with the losses of earlier trials if the code has not changed since.

    The search depends only on its seed and on the losses. So an interrupted search continues like an uninterrupted
    one: it makes the same trials again, without running their episodes. With a storage, several processes search
    together, and which trials they make depends on when they end too.

    Args:
        name: Key of `SEARCH_SPACES`.
        trials: Number of trials, including those in `folder` or in the storage.
        episodes: Number of episodes in each scenario.
        seed: Seed of the search.
        folder: Folder of the losses of the trials.
        scenarios: Names of the scenarios and of sets of scenarios.
        storage: File or URL for `open_storage`, which replaces the file in `folder`; opening it executes code that it
            contains.

    Raises:
        ValueError: If the file of the losses is damaged, or the storage cannot be opened.
    """
    space, start = _space_and_start(name, scenarios)
    measure = _loss_of_gains(name, episodes, scenarios)
    if storage is not None:
        study = open_search(name, episodes, seed, scenarios, storage)
        with quiet():
            run_trials(study, lambda trial: measure(_suggest(trial, space)), trials)
        return study
    study = optuna.create_study(sampler=_sampler(start, seed))
    study.enqueue_trial(start)
    folder.mkdir(parents=True, exist_ok=True)
    losses = _Losses(folder / f"{_study_name(name, episodes, seed, scenarios)}.trials.json")

    def objective(trial: optuna.Trial) -> float:
        gains = _suggest(trial, space)
        if (known := losses.find(trial.number, gains)) is not None:
            return known
        value = measure(gains)
        losses.add(trial.number, gains, value)
        return value

    study.optimize(objective, n_trials=trials, show_progress_bar=True)
    return study


def open_search(name: str, episodes: int, seed: int, scenarios: Sequence[str], storage: str) -> optuna.Study:
    """Open or create the study of a search that several processes share, see `search`."""
    _, start = _space_and_start(name, scenarios)
    sampler = TrialSampler(lambda number: _sampler(start, number), seed, start)
    with quiet():
        return open_study(_study_name(name, episodes, seed, scenarios), open_storage(storage), sampler)


def _space_and_start(name: str, scenarios: Sequence[str]) -> tuple[dict[str, SearchRange], dict[str, float]]:
    space = search_space(name, _find_all(scenarios)[0].simulation)
    return space, {path: first for path, (_, _, first) in space.items()}


def _study_name(name: str, episodes: int, seed: int, scenarios: Sequence[str]) -> str:
    """Return a name that differs for searches whose losses differ."""
    hashes = [scenario_hash(scenario) for scenario in _find_all(scenarios)]
    key = json.dumps([name, episodes, seed, _space_and_start(name, scenarios)[0], hashes, code_hash()])
    return f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:12]}"


def _sampler(start: dict[str, float], seed: int) -> optuna.samplers.CmaEsSampler:
    with warnings.catch_warnings():  # Optuna 6 will remove x0 and sigma0, so Optuna below 6 is required
        warnings.simplefilter("ignore", FutureWarning)
        return optuna.samplers.CmaEsSampler(x0=start, sigma0=0.1, seed=seed, warn_independent_sampling=False)


def _suggest(trial: optuna.Trial, space: dict[str, SearchRange]) -> dict[str, float]:
    return {path: trial.suggest_float(path, low, high, log=True) for path, (low, high, _) in space.items()}


def _loss_of_gains(name: str, episodes: int, scenarios: Sequence[str]) -> Callable[[dict[str, float]], float]:
    """Return the function that runs episodes with gains and returns their loss."""
    env, scenario = training_scenarios(episodes, scenarios), _find_all(scenarios)[0]
    present = _present_gains(name, scenario)

    def measure(gains: dict[str, float]) -> float:
        policy = _make(name, replace_gains(present, gains), scenario)
        return loss(run_training_scenarios(policy, env, TUNING_SEED, scenarios))

    return measure


def _present_gains(name: str, scenario: Scenario) -> Any:
    hangs = scenario.resolved_task.pendulum == "hanging"
    return gains_for(name, mirror_simulation(scenario.simulation) if hangs else scenario.simulation)


def _make(name: str, gains: Any, scenario: Scenario) -> Policy:
    """Return a controller with gains, which does not know the delays and lags of the scenario."""
    if scenario.resolved_task.pendulum == "hanging":
        return Hanging(CONTROLLER_FACTORIES[name](gains, mirror_simulation(scenario.simulation)))
    return CONTROLLER_FACTORIES[name](gains, scenario.simulation)


class _Losses:
    """The gains and the loss of each trial of a search, in a file that is written after each trial."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.trials: list[dict[str, Any]] = read_mapping(path).get("trials", []) if path.exists() else []
        valid = isinstance(self.trials, list) and all(
            isinstance(trial, dict) and isinstance(trial.get("loss"), float) for trial in self.trials
        )
        if not valid:
            raise ValueError(f"{path} is damaged: delete it, so that the search begins again")

    def find(self, number: int, gains: dict[str, float]) -> float | None:
        """Return the loss of a trial, None if it has not been computed."""
        known = self.trials[number] if number < len(self.trials) else {}
        return known["loss"] if known.get("gains") == gains else None

    def add(self, number: int, gains: dict[str, float], value: float) -> None:
        """Write the loss of a trial."""
        self.trials[number:] = [{"gains": gains, "loss": value}]
        write_text(self.path, json.dumps({"trials": self.trials}, indent=1) + "\n")


def check_names(names: Sequence[str]) -> None:
    """Check that controllers have a search space.

    Raises:
        ValueError: If one of them has none.
    """
    for name in names:
        if name not in SEARCH_SPACES:
            raise ValueError(
                f"there is no controller {name!r} to tune{suggest(name, SEARCH_SPACES)}; there are"
                f" {', '.join(SEARCH_SPACES)}"
            )


def tune(
    name: str,
    trials: int,
    episodes: int,
    seed: int,
    folder: Path,
    scenarios: Sequence[str] = SCENARIOS,
    storage: str | None = None,
) -> dict[str, Any]:
    """Search for gains, score them, write gains and scores to ``{name}.json`` in `folder`, and return them.

    Args:
        name: Key of `SEARCH_SPACES`.
        trials: Number of trials, including those in `folder`.
        episodes: Number of episodes in each scenario.
        seed: Seed of the search.
        folder: Folder of the results and of the losses of the trials.
        scenarios: Names of scenarios, as for `find_scenario`, and of sets of scenarios.
        storage: File or URL that several processes share, see `search`.

    Raises:
        ValueError: If the controller has no search space, a scenario is unknown, the scenarios have different nominal
            simulations, observations or sides of the pendulum, or a number is out of range.
    """
    check_names([name])
    held_out = [base for base in (split_changes(item)[0] for item in scenarios) if base in HELD_OUT]
    if not scenarios or held_out:
        raise ValueError(f"scenarios must be at least one, and not {(held_out or ['test'])[0]!r}, which is held out")
    if len({(scenario.resolved_task.pendulum, pendulum_arm(scenario)) for scenario in _find_all(scenarios)}) > 1:
        raise ValueError(
            "scenarios must agree in the side of the pendulum, and in whether the error counts its direction"
            " (pendulum_first): tune for them apart"
        )
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = search(name, trials, episodes, seed, folder, scenarios, storage)
    values = {path: float(f"{value:.3g}") for path, value in study.best_params.items()}
    scenario = _find_all(scenarios)[0]
    present = _present_gains(name, scenario)
    before, after = (
        score(_make(name, gains, scenario), scenarios=scenarios) for gains in (present, replace_gains(present, values))
    )
    command = f"quadpend tune {name} --trials {trials} --episodes {episodes} --seed {seed}"
    if tuple(scenarios) != SCENARIOS:
        command += f" --scenarios {shlex.join(scenarios)}"
    if storage is not None:
        command += f" --storage {shlex.quote(describe_storage(storage))}"
    found = {
        "command": command,
        "gains": values,
        "score": round(float(np.mean([rmse for _, rmse in after.values()])), 2),
        "score of the gains in baselines/quadpend_baselines/gains.py": round(
            float(np.mean([rmse for _, rmse in before.values()])), 2
        ),
        "survival and penalised rmse": {scenario: [round(x, 1) for x in pair] for scenario, pair in after.items()},
    }
    write_text(folder / f"{name}.json", json.dumps(found, indent=1) + "\n")
    return found
