"""Tune the gains of the classical controllers by the metric of the comparisons.

The score is the penalised RMSE in mm, averaged over the episodes and then over the scenarios, by default those of the
set ``training``. The scenarios must have the same nominal simulation, for which the controllers are designed. A fall
counts as 1 m, the largest possible value of an episode. The search (CMA-ES of Optuna) starts from the present gains
(for rigid vehicles those of the hummingbird, scaled), and minimises a loss that adds a larger term for an earlier
fall. So the search also makes progress between gains with which every episode ends in a fall. Few episodes flatter the
best of many trials. So the gains of the best trials are rounded to three digits and flown again, beside the present
ones, in more and other episodes; those with the smallest loss are chosen, and scored in episodes that nothing has
used.

A search continues from the trials in its file, whose lock is one of the operating system: a killed process leaves it
unlocked, and loses its running trial only.

The search space of a controller can ask for a delay margin, by which all its actions can come later than expected
before the loop at hover is unstable (`quadpend_baselines.modelling.linear_loop`, which needs the extra `control`).
Gains with a smaller one do not fly: they have the loss of falls at the start, the larger the smaller the margin is.
"""

import hashlib
import json
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from filelock import FileLock
from gymnasium.vector import VectorEnv
from optuna.distributions import FloatDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from quadpend_baselines import Policy
from quadpend_baselines.controllers.controller import Hanging, mirror_simulation
from quadpend_baselines.estimation.loop import Loop
from quadpend_baselines.gains import gains_for, scale_gains, tuning
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_baselines.policy.rollout import rollout
from quadpend_baselines.registry import controller_of
from quadpend_gym import Simulation
from quadpend_gym.core.files import read_mapping
from quadpend_gym.core.nested import changed, flat
from quadpend_gym.core.settings import suggest
from quadpend_gym.scenarios import Scenario, find_scenarios, refuse_held_out, scenario_data
from quadpend_gym.vehicles import VEHICLES
from quadpend_train.common.files import write_text
from quadpend_train.common.interruptions import progress_bar, signals_wait
from quadpend_train.common.text import brief
from quadpend_train.evaluation.episodes import TUNING_SEED, EpisodeResults, collect_results, pendulum_arm
from quadpend_train.training.environment import concatenate_scenarios

CHOICE_SEED, SCORE_SEED = TUNING_SEED + 50_000, TUNING_SEED + 100_000  # of the first episodes of choice and score
CHOICE_EPISODES, SCORE_EPISODES = 48, 200  # in each scenario
FINALISTS = 6  # trials among which the choice is
# For each controller, ranges of gains, [low, high], by their paths: for the paper's vehicle, and for the hummingbird
_DATA = read_mapping(Path(__file__).with_name("search_spaces") / "gains.toml")
LEAST_MARGINS: dict[str, float] = _DATA.pop("delay_margin")  # s, of rigid vehicles
SEARCH_SPACES, HUMMINGBIRD_SPACES = ({name: flat(given) for name, given in group.items()} for group in _DATA.values())


class Search:
    """A search for the gains of a controller, with `episodes` in each scenario.

    With `geometric`, the loss is the geometric mean of the errors of the scenarios, and 1 to 2 m times the share of
    falls. So a tenth less error counts as much in a calm scenario as in a hard one.
    """

    def __init__(
        self,
        name: str,
        scenarios: Sequence[str | Scenario] = ("training",),
        episodes: int = 48,
        geometric: bool = False,
    ) -> None:
        self.name, self.episodes, self.geometric = name, episodes, geometric
        refuse_held_out(scenarios)
        self.scenarios = find_scenarios(scenarios)
        found = [*self.scenarios.values()]
        if len({(scenario.task.pendulum, pendulum_arm(scenario)) for scenario in found}) > 1:
            raise ValueError(
                "scenarios must agree in the side of the pendulum, and in whether the error counts its direction"
                " (pendulum_first): tune for them apart"
            )
        simulation, self.hangs = found[0].simulation, found[0].task.pendulum == "hanging"
        self.designed = mirror_simulation(simulation) if self.hangs else simulation
        self.seen = Loop(observation=Loop.known(found[0]).observation)  # no delays and lags
        self.env = concatenate_scenarios(found, episodes * len(found))
        own, ranges = search_space(name, simulation)
        self.present = gains_for(name, self.designed)
        self.space = {path: FloatDistribution(*given, log=True) for path, given in ranges.items()}
        # A hanging pendulum on the paper's vehicle has gains of its own.
        first = own if simulation.vehicle.attitude == "rigid" else self.present
        self.start = {path: attrgetter(path)(first) for path in self.space}

    def open(self, file: Path, seed: int = 0) -> optuna.Study:
        """Open or create the study in a file, whose first trial has the values `start`."""
        ranges = {path: [item.low, item.high] for path, item in self.space.items()}
        scenarios = {name: scenario_data(scenario) for name, scenario in self.scenarios.items()}
        settings = [self.episodes, scenarios, ranges, asdict(self.present)]
        key = json.dumps([*settings, "geometric"] if self.geometric else settings)
        name = f"{self.name}-{hashlib.sha256(key.encode()).hexdigest()[:12]}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file = file.resolve()
        lock: Any = FileLock(file.with_name(f"{file.name}.filelock"), timeout=60.0)
        with quiet():
            try:
                storage = JournalStorage(JournalFileBackend(str(file), lock))
                study = optuna.create_study(study_name=name, storage=storage, load_if_exists=True)
            except Exception as error:  # Optuna raises exceptions of many types
                raise ValueError(f"{file} is not a file of trials: {brief(error)}") from error
            number = int(np.random.SeedSequence([seed, len(study.trials)]).generate_state(1)[0])
            # Optuna 6 will remove x0 and sigma0, so Optuna below 6 is required
            study.sampler = optuna.samplers.CmaEsSampler(
                x0=self.start, sigma0=0.1, seed=number, warn_independent_sampling=False
            )
            if all(trial.state == TrialState.FAIL for trial in study.trials):
                study.enqueue_trial(self.start)
        return study

    def run(self, study: optuna.Study, trials: int) -> None:
        """Take trials until the study has enough finished ones."""
        count = len(finished(study))
        with quiet(), progress_bar(total=trials, initial=count, unit="trial") as bar:
            for _ in range(count, trials):
                with signals_wait():  # so that file and memory stay the same
                    trial = study.ask(dict(self.space))
                value = self.loss(trial)
                with signals_wait():
                    study.tell(trial, value)
                bar.update()

    def policy(self, gains: dict[str, float]) -> Policy:
        """Return the controller with other gains, which does not know the delays and lags of the scenarios."""
        policy = controller_of(self.name, changed(self.present, gains)).designed_for(self.designed, self.seen)
        return Hanging(policy) if self.hangs else policy

    def loss(self, trial: optuna.Trial) -> float:
        """Return the loss of a trial."""
        return self.loss_of(trial.params, self.env, TUNING_SEED)

    def loss_of(self, gains: dict[str, float], env: VectorEnv[Any, Any, Any], seed: int) -> float:
        """Return the mean penalised RMSE in mm, with up to 1 m added for each fall, the more the earlier it is."""
        policy = self.policy(gains)
        if (missing := self._missing_margin(policy)) > 0.0:
            return 1000.0 * (2.0 + missing)
        found = fly(policy, env, [*self.scenarios.values()], seed)
        remaining = 1.0 - found.steps / found.error.shape[-1]
        falls = np.where(found.survived, 0.0, remaining)
        if not self.geometric:
            return 1000.0 * float(np.mean(found.penalised_rmse + falls))
        errors = found.penalised_rmse.reshape(len(self.scenarios), -1).mean(axis=1)
        return 1000.0 * float(np.exp(np.mean(np.log(errors))) + np.mean(~found.survived + falls))

    def _missing_margin(self, policy: Policy) -> float:
        """Return the share of the delay margin that the design lacks in the first scenario's loop at hover."""
        if (least := LEAST_MARGINS.get(self.name)) is None or self.designed.vehicle.attitude != "rigid":
            return 0.0
        from quadpend_baselines.modelling import linear_loop

        scenario = next(iter(self.scenarios.values()))
        linear = linear_loop.linear_policy(policy, scenario)
        return max(1.0 - linear_loop.margins(linear_loop.vehicle_model(scenario), linear).delay / least, 0.0)


@contextmanager
def quiet() -> Iterator[None]:
    """Let Optuna print no line for each trial, and no warning about what a later version will remove."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield


def finished(study: optuna.Study) -> list[FrozenTrial]:
    """Return the trials that have ended."""
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def search_space(name: str, simulation: Simulation) -> tuple[Any, dict[str, tuple[float, float]]]:
    """Return gains for a vehicle, those of the hummingbird scaled to rigid ones, and ranges in proportion to them."""
    spaces = HUMMINGBIRD_SPACES if simulation.vehicle.attitude == "rigid" else SEARCH_SPACES
    if name not in spaces:
        raise ValueError(
            f"there is no controller {name!r} to tune{suggest(name, spaces)}; there are {', '.join(spaces)}"
        )
    if spaces is SEARCH_SPACES:
        own, given_for = gains_for(name, simulation), tuning(name).gains
    else:
        hummingbird = Simulation(VEHICLES["hummingbird"])
        given_for = gains_for(name, hummingbird)
        models = [equivalent_model(item).parameters for item in (hummingbird, simulation)]
        own = scale_gains(given_for, *models)
    ratios = {path: attrgetter(path)(own) / attrgetter(path)(given_for) for path in spaces[name]}
    return own, {path: (low * ratios[path], high * ratios[path]) for path, (low, high) in spaces[name].items()}


def fly(policy: Policy, env: VectorEnv[Any, Any, Any], scenarios: Sequence[Scenario], seed: int) -> EpisodeResults:
    """Run a policy through the same seeds in every scenario of the environment.

    The results have the shape (scenarios · episodes,), the episodes of one scenario after those of another.
    """
    episodes = env.num_envs // len(scenarios)
    seeds = [seed + episode for _ in scenarios for episode in range(episodes)]
    lengths = np.repeat([scenario.steps for scenario in scenarios], episodes)
    unscored = np.repeat([scenario.unscored_steps for scenario in scenarios], episodes)
    first = scenarios[0]
    arguments = lengths, first.simulation.period, pendulum_arm(first), unscored
    return collect_results(rollout(policy, env, seeds), *arguments)


def score(policy: Policy, scenarios: Sequence[str | Scenario]) -> dict[str, tuple[float, float]]:
    """Return survival (%) and mean penalised RMSE (mm) in each scenario."""
    found = find_scenarios(scenarios)
    env = concatenate_scenarios([*found.values()], SCORE_EPISODES * len(found))
    results = fly(policy, env, [*found.values()], SCORE_SEED)
    parts = (np.split(array, len(found)) for array in (results.survived, results.penalised_rmse))
    return {
        name: (100.0 * float(survived.mean()), 1000.0 * float(rmse.mean()))
        for name, survived, rmse in zip(found, *parts, strict=True)
    }


def rounded(gains: dict[str, float]) -> dict[str, float]:
    """Return gains with three digits."""
    return {path: float(f"{value:.3g}") for path, value in gains.items()}


def tune(search: Search, study: optuna.Study, trials: int, folder: Path) -> dict[str, Any]:
    """Search for gains, score them, write gains and scores to ``{name}.json`` in `folder`, and return them.

    The study may have trials already, which count.
    """
    search.run(study, trials)
    best = sorted(finished(study), key=attrgetter("value"))[:FINALISTS]
    candidates = [{}, *(rounded(trial.params) for trial in best)]
    scenarios = [*search.scenarios.values()]
    env = concatenate_scenarios(scenarios, CHOICE_EPISODES * len(scenarios))
    losses = [search.loss_of(gains, env, CHOICE_SEED) for gains in candidates]
    values = candidates[int(np.argmin(losses))] or rounded(
        {path: attrgetter(path)(search.present) for path in search.space}
    )
    after = score(search.policy(values), scenarios)
    found = {
        "controller": search.name,
        "scenarios": [*search.scenarios],
        "trials": len(study.trials),
        "gains": values,
        "loss": round(min(losses), 2),
        "loss of the present gains": round(losses[0], 2),
        "score": round(float(np.mean([rmse for _, rmse in after.values()])), 2),
        "survival and penalised rmse": {name: [round(x, 1) for x in pair] for name, pair in after.items()},
    }
    write_text(folder / f"{search.name}.json", json.dumps(found, indent=1) + "\n")
    return found
