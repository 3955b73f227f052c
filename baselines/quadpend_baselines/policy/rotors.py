"""Flying four rotors with a policy made for thrust and torques."""

from typing import Any

import numpy as np

from quadpend_baselines.policy.protocol import Policy
from quadpend_gym import Simulation
from quadpend_gym.actuators import Rotors
from quadpend_gym.core.arrays import Floats32


class RotorAllocation:
    """`policy` for an environment whose action are the thrusts of `rotors`.

    Its actions are unmixed, and each rotor does what it can: where one would have to pull or to push too hard, thrust
    and torques come out differently, and the policy does not know.

    Args:
        policy: anything whose actions are thrust and torques.
        rotors: as the environment has them.
        simulation: as the environment has it.

    Raises:
        ValueError: the rotors can turn harder than the simulation's actuators.
    """

    def __init__(self, policy: Policy, rotors: Rotors | None = None, simulation: Simulation | None = None) -> None:
        """Invert the mixing."""
        self.policy = policy
        self._unmixing = np.linalg.inv((rotors or Rotors()).mixing(simulation or Simulation()))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Action and memory; see `Policy.predict`."""
        action, memory = self.policy.predict(observation, state, episode_start, deterministic)
        return np.clip(action @ self._unmixing.T, -1.0, 1.0).astype(np.float32), memory
