"""Finite differences, for a policy that needs velocities in an environment that does not observe them."""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.policy.protocol import PolicyWrapper, episode_start_mask
from quadpend_gym import OBSERVATION_FIELDS, read_observation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_SCALE, OBSERVATION_SIZE, OUTPUT_FEEDBACK, OUTPUT_FEEDBACK_COLUMNS

# Observed fields and the fields of their rates.
_RATES = {"tracking_error": "tracking_error_rate", "direction": "direction_rate", "attitude": "euler_rate"}


class _Memory(NamedTuple):
    policy: Any
    outputs: dict[str, Floats]  # the last values of the observed fields, shape (n, 3) each


class FiniteDifferencePolicy(PolicyWrapper):
    """A policy for environments without observed velocities that computes rates from two successive observations.

    At the first step of an episode the rates of the tracking error, the direction and the roll and pitch angles are
    zero, and the yaw rate is that of the reference. The control period is in s.
    """

    def __init__(self, policy: Policy, period: float) -> None:
        super().__init__(policy)
        self.period = period

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory for observations of shape (n, 27); see `quadpend_baselines.Policy.predict`."""
        started = episode_start_mask(episode_start, state is None, len(observation))[:, np.newaxis]
        outputs = {name: read_observation(observation, name, OUTPUT_FEEDBACK) for name in _RATES}
        full = np.empty((len(observation), OBSERVATION_SIZE), np.float32)
        full[:, OUTPUT_FEEDBACK_COLUMNS] = observation
        for name, value in outputs.items():
            last = value if state is None else np.where(started, value, state.outputs[name])
            rate = (value - last) / self.period
            if name == "attitude":  # its third number is the yaw error, but that of euler_rate is the yaw rate ψ̇
                rate[:, 2] += read_observation(observation, "yaw_reference", OUTPUT_FEEDBACK)[:, 1]
            columns = OBSERVATION_FIELDS[_RATES[name]]
            full[:, columns] = rate / OBSERVATION_SCALE[columns]
        action, memory = self.policy.predict(full, state and state.policy, episode_start, deterministic)
        return action, _Memory(memory, outputs)

    def estimated_disturbance(self, memory: Any) -> Floats:
        """Return the estimate of the wrapped policy."""
        return self.policy.estimated_disturbance(memory.policy)


def with_velocities(policy: Policy, scenario: Scenario) -> Policy:
    """Return a policy for a scenario, in which velocities that it needs may not be observed."""
    hidden = scenario.observation == OUTPUT_FEEDBACK and policy.observation_sizes == (OBSERVATION_SIZE,)
    return FiniteDifferencePolicy(policy, scenario.simulation.period) if hidden else policy
