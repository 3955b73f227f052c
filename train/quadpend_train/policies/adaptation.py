"""Adapt a policy to a scenario: its simulation, its actuators and what it observes."""

from typing import Any

import numpy as np

from quadpend_baselines import Policy, RotorAllocation
from quadpend_gym.actuators import Rotors
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_train.policies.finite_differences import FiniteDifferencePolicy
from quadpend_train.scenarios import Scenario


def adapt_policy(policy: Policy, scenario: Scenario) -> Policy:
    """Return the policy for a scenario.

    - A classical controller, also the base controller of a hybrid, receives the scenario's nominal simulation.
    - Where the action commands rotors, a classical controller receives a `RotorAllocation`.
    - Where velocities are not observed, a learned policy that needs them receives finite differences.

    A learned policy has the attribute `observation_sizes`, the sizes of the observations that it accepts. Its actions
    are those of the environment.
    """
    adaptable: Any = policy
    if hasattr(policy, "with_simulation"):
        policy = adaptable.with_simulation(scenario.simulation)
    sizes = getattr(policy, "observation_sizes", None)
    if sizes is None:
        rotors = [model for model in scenario.actuators if isinstance(model, Rotors)]
        return RotorAllocation(policy, rotors[0], scenario.simulation) if rotors and policy is not adaptable else policy
    if scenario.output_feedback and tuple(sizes) == (OBSERVATION_SIZE,):
        return FiniteDifferencePolicy(policy, scenario.simulation.period)
    return policy


def estimated_disturbance(policy: Policy, memory: Any) -> Floats:
    """Return the disturbance that a policy estimates, shape (n, 9); nan, shape (1, 9), if it estimates none.

    Args:
        policy: A policy, adapted by `adapt_policy` or not.
        memory: The memory that its `predict` returned.
    """
    inner, inner_memory = getattr(policy, "policy", policy), memory
    if isinstance(policy, FiniteDifferencePolicy):
        inner_memory = memory.policy
    estimate: Any = getattr(inner, "estimated_disturbance", None)
    return np.full((1, DISTURBANCE_SIZE), np.nan) if estimate is None else np.asarray(estimate(inner_memory))
