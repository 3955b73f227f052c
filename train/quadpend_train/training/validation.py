"""How well a policy flies the scenarios that it is trained in, in episodes that it is not trained on."""

from typing import Any, NamedTuple

from quadpend_baselines import Policy
from quadpend_baselines.policy.rollout import rollout
from quadpend_train.evaluation.episodes import VALIDATION_SEED, collect_results
from quadpend_train.scenarios import expand, find_scenario
from quadpend_train.training.environment import concatenate_scenarios
from quadpend_train.training.settings import TrainSettings


class Score(NamedTuple):
    """A line of the training curve."""

    steps: int  # of the environment so far
    seconds: float  # of training so far
    survival: float  # share of the episodes
    penalised_rmse: float  # m, the mean over all scenarios


def validate(policy: Policy, settings: TrainSettings, seed: int = VALIDATION_SEED) -> tuple[float, float]:
    """Survival (a share) and penalised RMSE (m): means over the scenarios of a run, in the episodes from `seed` on."""
    scenarios = [find_scenario(name) for name in expand(settings.scenario)]
    env = concatenate_scenarios(scenarios, settings.n_eval_episodes * len(scenarios))
    told: Any = policy
    policy = told.with_simulation(scenarios[0].simulation) if hasattr(policy, "with_simulation") else policy
    flights = collect_results(rollout(policy, env, seed), env.num_envs)
    return float(flights.survived.mean()), float(flights.penalised_rmse.mean())
