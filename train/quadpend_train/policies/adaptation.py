"""Policies adapted to a scenario."""

from typing import Any

import numpy as np

from quadpend_baselines import Policy, RotorAllocation
from quadpend_gym.actuators import Rotors
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_train.policies.finite_differences import FiniteDifferencePolicy
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.scenarios import Scenario


def adapt_policy(policy: Policy, scenario: Scenario) -> Policy:
    """The policy as it flies in a scenario.

    A controller, or a policy's companion, is told the nominal simulation. A controller flies rotors, where there are
    any, through their mixing. A learned policy that wants to see velocities takes differences where they are hidden.
    """
    adaptable: Any = policy
    if hasattr(policy, "with_simulation"):
        policy = adaptable.with_simulation(scenario.simulation)
    if not isinstance(policy, MlpPolicy):
        rotors = [model for model in scenario.actuators if isinstance(model, Rotors)]
        return RotorAllocation(policy, rotors[0], scenario.simulation) if rotors and policy is not adaptable else policy
    if scenario.output_feedback and policy.sizes == (OBSERVATION_SIZE,):
        return FiniteDifferencePolicy(policy, scenario.simulation.period)
    return policy


def estimated_disturbance(policy: Policy, memory: Any) -> Floats:
    """The disturbance that a policy, seated or not, has estimated, shape (n, 9); nan where it estimates none.

    Args:
        policy: flown.
        memory: what its `predict` returned.
    """
    flown, known = (getattr(policy, "policy", policy), memory)
    if isinstance(policy, FiniteDifferencePolicy):
        known = memory.policy
    estimate: Any = getattr(flown, "estimated_disturbance", None)
    return np.full((1, DISTURBANCE_SIZE), np.nan) if estimate is None else np.asarray(estimate(known))
