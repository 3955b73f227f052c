"""Adapt a policy to a scenario: its simulation, its actuators and what it observes."""

from typing import Any

import numpy as np
from gymnasium import logger
from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy, RotorAllocation
from quadpend_baselines.estimation.loop import Loop, design_for
from quadpend_baselines.hybrid.wrappers import NO_HYBRID
from quadpend_baselines.swing.hanging import Hanging
from quadpend_gym.actuators import Rotors
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.factories import describe_error
from quadpend_gym.core.models import is_project_class
from quadpend_gym.physics.state import DISTURBANCE_SIZE
from quadpend_gym.scenarios import Scenario, short_name
from quadpend_gym.tasks.observation import OBSERVATION_SIZE
from quadpend_train.policies.finite_differences import FiniteDifferencePolicy
from quadpend_train.policies.mlp_policy import lacks_interface
from quadpend_train.policies.own import PROTOCOL, FactoryPolicy, check_predict


def known_loop(scenario: Scenario) -> Loop:
    """Return the delays and lags of a scenario that controllers know."""
    return Loop.of(scenario.sensors, scenario.actuators) if scenario.loop_known else Loop()


def adapt_policy(policy: Policy, scenario: Scenario) -> Policy:
    """Return the policy for a scenario.

    - A policy with the method `with_simulation` receives the scenario's nominal simulation: a classical controller,
      also as base controller of a hybrid, and an own policy whose factory takes the simulation. If the method has the
      argument `loop`, it also receives the known delays and lags, unless the scenario has
      `loop_known = false`. Where the pendulum is to hang, a classical controller becomes a `Hanging` one.
    - Where the action commands rotors, such a policy, if it is not learned, receives a `RotorAllocation`.
    - Where velocities are not observed, a learned policy that needs them receives finite differences.

    A learned policy has the attribute `observation_sizes`, the sizes of the observations that it accepts. Its actions
    are those of the environment.
    """
    adaptable: Any = policy
    sizes, hangs = getattr(policy, "observation_sizes", None), scenario.resolved_task.pendulum == "hanging"
    if hangs and getattr(policy, "hybrid", None) is not None:
        raise ValueError(NO_HYBRID)
    if hangs and sizes is None and is_project_class(type(policy)) and not isinstance(policy, FactoryPolicy):
        policy = Hanging(policy, scenario.simulation, known_loop(scenario))
    elif hasattr(policy, "with_simulation"):
        policy = design_for(policy, scenario.simulation, known_loop(scenario))
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
    while isinstance(policy, RotorAllocation | FiniteDifferencePolicy | FactoryPolicy):
        memory = memory.policy if isinstance(policy, FiniteDifferencePolicy) else memory
        policy = policy.policy
    estimate: Any = getattr(policy, "estimated_disturbance", None)
    return np.full((1, DISTURBANCE_SIZE), np.nan) if estimate is None else np.asarray(estimate(memory))


def check_policy(name: str, policy: Policy, scenario_name: str, scenario: Scenario) -> None:
    """Fly a policy for two steps in two sub-environments of a scenario, so that a mismatch is found early.

    A learned policy from elsewhere is warned about unless the scenario has the interface ``"wrench"``, since nothing
    says what its actions command.

    Args:
        name: Name of the policy for error messages.
        policy: The policy.
        scenario_name: Name of the scenario for error messages.
        scenario: The scenario.

    Raises:
        ValueError: If the policy fails, does not fit the scenario, or returns no valid action.
    """
    interface, card = scenario.simulation.interface, getattr(policy, "card", {})
    learned = getattr(policy, "observation_sizes", None) and not isinstance(policy, FactoryPolicy)
    if learned and interface != "wrench" and lacks_interface(card):
        logger.warn("nothing says what the actions of %s command: they are taken as those of %r", name, interface)
    env, memory = scenario.make_vec(2, AutoresetMode.SAME_STEP), None
    observation, _ = env.reset(seed=0)
    own = not is_project_class(type(getattr(policy, "policy", policy)))
    try:
        adapted = check_predict(name, adapt_policy(check_predict(name, policy), scenario))
        for started in ([True, True], [True, False]):
            returned: Any = adapted.predict(observation, memory, np.array(started), deterministic=True)
            if not isinstance(returned, tuple) or len(returned) != 2:
                raise ValueError(f"predict returned {type(returned).__name__}, not a tuple of actions and memory")
            action, memory = returned
            observation, *_ = env.step(action)
    except Exception as error:  # own code may raise exceptions of any type
        if not own and not isinstance(error, ValueError):
            raise
        what = str(error) if isinstance(error, ValueError) else describe_error(error)
        rule = f"; {PROTOCOL}" if own and PROTOCOL not in what else ""
        raise ValueError(f"{name} does not fit the scenario {short_name(scenario_name)}: {what}{rule}") from error
