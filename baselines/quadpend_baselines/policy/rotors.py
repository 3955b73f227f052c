"""Rotor allocation: convert thrust and torques of a policy to the thrusts of four rotors."""

from typing import Any

import numpy as np

from quadpend_baselines.policy.protocol import Policy, PolicyWrapper
from quadpend_gym import Simulation
from quadpend_gym.actuators import Rotors, mixing
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario


class RotorAllocation(PolicyWrapper):
    """Wrap a policy that commands thrust and torques for an environment whose actions are the thrusts of four rotors.

    The inverse of the rotors' mixing matrix converts thrust and torques into rotor thrusts. Each is clipped to its
    range; the policy is not informed that thrust and torques then differ from those that it commands.
    """

    def __init__(self, policy: Policy, rotors: Rotors | None = None, simulation: Simulation | None = None) -> None:
        super().__init__(policy)
        self._unmixing = np.linalg.inv(mixing(rotors or Rotors(), simulation or Simulation()))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        action, memory = self.policy.predict(observation, state, episode_start, deterministic)
        return np.clip(action @ self._unmixing.T, -1.0, 1.0).astype(np.float32), memory


def allocate_rotors(policy: Policy, scenario: Scenario) -> Policy:
    """Return a policy whose actions are thrust and torques for a scenario, in which they may command rotors."""
    rotors = [model for model in scenario.actuators if isinstance(model, Rotors)]
    return RotorAllocation(policy, rotors[0], scenario.simulation) if rotors else policy
