"""What policies read, from the observation of a scenario: by the names of its fields, or errors from positions."""

from typing import Any

import numpy as np

from quadpend_baselines.estimation.measurement import errors_of
from quadpend_baselines.policy.protocol import Policy, PolicyWrapper
from quadpend_gym import Parameters
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK


class SelectedFields(PolicyWrapper):
    """A policy that reads some columns of the observation, or reads them in another order."""

    def __init__(self, policy: Policy, columns: Any) -> None:
        super().__init__(policy)
        self.columns = columns

    def observed(self, observation: Any) -> Any:
        """Return these columns."""
        return np.asarray(observation)[..., self.columns]


class FedErrors(PolicyWrapper):
    """A policy that reads errors where positions in the world are observed: the errors of the pole that is believed.

    Args:
        policy: The policy.
        places: Columns of the fields of `LAB`.
        read: Columns of the fields of `OUTPUT_FEEDBACK` that the policy reads.
        parameters: Nominal parameters.
    """

    def __init__(self, policy: Policy, places: Any, read: Any, parameters: Parameters) -> None:
        super().__init__(policy)
        self.places, self.read, self.parameters = places, read, parameters

    def observed(self, observation: Any) -> Any:
        """Return the errors that the policy reads."""
        given = np.asarray(observation, np.float32)
        errors = errors_of(np.atleast_2d(given)[:, self.places], self.parameters)[:, self.read]
        return errors.reshape(*given.shape[:-1], -1)


def fed_by_name(policy: Policy, scenario: Scenario) -> Policy:
    """Return a policy for a scenario, whose observation may have more fields than it reads, or another order.

    A policy that reads errors gets them where positions in the world are observed.
    """
    seen = scenario.observation
    if policy.layouts is None or seen in policy.layouts:
        return policy
    for layout in policy.layouts:
        if set(layout) <= set(seen):
            return SelectedFields(policy, seen.select(layout))
        if set(layout) <= set(OUTPUT_FEEDBACK) and set(LAB) <= set(seen):
            return FedErrors(policy, seen.select(LAB), OUTPUT_FEEDBACK.select(layout), scenario.simulation.parameters)
    lacking = min(([name for name in layout if name not in seen] for layout in policy.layouts), key=len)
    raise ValueError(
        f"the policy reads {', '.join(lacking)}, which the scenario does not observe; it observes {', '.join(seen)}"
    )
