"""How well a policy flies the scenarios that it is trained in, in episodes that it is not trained on."""

from typing import Any, NamedTuple

from baselines import Policy
from baselines.rollout import rollout
from train.environment import together
from train.flights import VALIDATION_SEED, record
from train.scenarios import expand, find_scenario
from train.settings import TrainSettings


class Score(NamedTuple):
    """A line of the training curve."""

    steps: int  # of the environment so far
    seconds: float  # of training so far
    survival: float  # share of the episodes
    penalised_rmse: float  # m, the mean over all scenarios


def validate(policy: Policy, settings: TrainSettings, seed: int = VALIDATION_SEED) -> tuple[float, float]:
    """Survival (a share) and penalised RMSE (m): means over the scenarios of a run, in the episodes from `seed` on."""
    scenarios = [find_scenario(name) for name in expand(settings.scenario)]
    env = together(scenarios, settings.evaluation_episodes * len(scenarios))
    told: Any = policy
    policy = told.told(scenarios[0].simulation) if hasattr(policy, "told") else policy
    flights = record(rollout(policy, env, seed), env.num_envs)
    return float(flights.survived.mean()), float(flights.penalised_rmse.mean())
