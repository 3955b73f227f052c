"""Validation: score a policy in its training scenarios, in episodes that are not used for training."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.rollout import rollout
from quadpend_train.evaluation.episodes import VALIDATION_SEED, collect_results
from quadpend_train.scenarios import expand_sets, find_scenario
from quadpend_train.training.environment import concatenate_scenarios
from quadpend_train.training.settings import TrainSettings


class Score(NamedTuple):
    """One point of the learning curve.

    Attributes:
        steps: Timesteps of training before the evaluation.
        seconds: Duration of training before the evaluation, s.
        survival: Share of episodes without a fall, that is an early termination.
        penalised_rmse: Mean over all episodes of the root mean square of the tracking error, m; a fall counts as 1 m.
    """

    steps: int
    seconds: float
    survival: float
    penalised_rmse: float


def validate(policy: Policy, settings: TrainSettings, seed: int = VALIDATION_SEED) -> tuple[float, float]:
    """Run a policy in the training scenarios of a run.

    Args:
        policy: The policy. If it has a base controller, that is designed for the nominal simulation of the scenarios.
        settings: The settings of the run.
        seed: The seed of the first episode.

    Returns:
        Survival and penalised RMSE (m), see `Score`; means over `n_eval_episodes` episodes of each scenario.
    """
    scenarios = [find_scenario(name) for name in expand_sets(settings.scenarios)]
    env = concatenate_scenarios(scenarios, settings.n_eval_episodes * len(scenarios))
    adaptable: Any = policy
    if hasattr(policy, "with_simulation"):
        policy = adaptable.with_simulation(scenarios[0].simulation)
    lengths = np.repeat([scenario.steps for scenario in scenarios], settings.n_eval_episodes)
    results = collect_results(rollout(policy, env, seed), lengths, scenarios[0].simulation.period)
    return float(results.survived.mean()), float(results.penalised_rmse.mean())
