"""A brief flight of a policy before a long evaluation."""

import numpy as np
from gymnasium import logger
from gymnasium.vector import AutoresetMode

from quadpend_baselines import Policy
from quadpend_gym.core.factories import describe_error
from quadpend_gym.scenarios import Scenario
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.policies.objects import PROTOCOL, ObjectPolicy
from quadpend_train.policies.own import FactoryPolicy


def check_policy(name: str, policy: Policy, scenario_name: str, scenario: Scenario) -> None:
    """Fly a policy for two steps in two sub-environments of a scenario, so that a mismatch is found early.

    An exported policy from elsewhere is warned about unless the scenario has the interface ``"wrench"``, since nothing
    says what its actions command.

    Args:
        name: Name of the policy for error messages.
        policy: The policy.
        scenario_name: Name of the scenario for error messages.
        scenario: The scenario.

    Raises:
        ValueError: If the policy fails, does not fit the scenario, or returns no valid action.
    """
    interface, memory = scenario.simulation.interface, None
    if interface != "wrench" and isinstance(policy, MlpPolicy) and "interface" not in policy.card:
        logger.warn("nothing says what the actions of %s command: they are taken as those of %r", name, interface)
    try:
        adapted = policy.adapt(scenario)
        env = adapted.wrap(scenario.make_vec(2, AutoresetMode.SAME_STEP))
        observation, _ = env.reset(seed=0)
        for started in ([True, True], [True, False]):
            action, memory = adapted.predict(observation, memory, np.array(started), deterministic=True)
            observation, *_ = env.step(action)
    except Exception as error:  # own code may raise exceptions of any type
        what = str(error) if isinstance(error, ValueError) else describe_error(error)
        own = isinstance(policy, FactoryPolicy | ObjectPolicy) and PROTOCOL not in what
        rule = f"; {PROTOCOL}" if own else ""
        raise ValueError(f"{name} does not fit the scenario {scenario_name}: {what}{rule}") from error
