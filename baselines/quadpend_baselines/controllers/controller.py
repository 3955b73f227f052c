"""The base class of the classical controllers: designed for a nominal simulation and the known part of its loop."""

from typing import Any

import numpy as np

from quadpend_baselines.controllers.law import ObserverKind
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.estimation.loop import READABLE, Loop
from quadpend_baselines.policy.protocol import Policy
from quadpend_baselines.policy.told import for_told_pole
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import ObservationLayout

NO_LOAD = "classical controllers balance an upright pendulum and fly no hanging load"


class Controller(Policy):
    """A classical controller of thrust and torques.

    Args:
        gains: Gains, or a function that returns them for a nominal simulation.
        simulation: Nominal plant, torque limits and control period; None: the default simulation.
        loop: The known delays and lags of the loop; None: there are none.

    Attributes:
        observer: What estimates the disturbance for hybrids on the controller.
        has_c: Whether the controller can be written as C.
    """

    observer: ObserverKind = "hidden"
    has_c: bool = False
    layouts: tuple[ObservationLayout, ...] = READABLE

    def __init__(self, gains: Any, simulation: Simulation | None = None, loop: Loop | None = None) -> None:
        self.given_gains, self.simulation, self.loop = gains, simulation or Simulation(), loop or Loop()
        self.gains = gains(self.simulation) if callable(gains) else gains

    def designed_for(self, simulation: Simulation, loop: Loop | None = None) -> "Controller":
        """Return the same controller, designed for another nominal simulation and loop."""
        return type(self)(self.given_gains, simulation, loop)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        single = np.ndim(observation) == 1
        action, memory = self.act(np.atleast_2d(np.asarray(observation, np.float32)), state, episode_start)
        return (action[0] if single else action), memory

    def act(self, observation: Floats32, state: Any, episode_start: Any) -> tuple[Floats32, Any]:
        """Return actions, shape (n, 4), and memory for observations of n rows; see `Policy.predict`."""
        raise NotImplementedError

    def adapt(self, scenario: Scenario) -> Policy:
        """Return the controller designed for a scenario, its known loop and poles that are told."""
        return for_told_pole(self._adapt, scenario)

    def _adapt(self, scenario: Scenario) -> Policy:
        if scenario.task.pendulum == "hanging":
            raise ValueError(NO_LOAD)
        return fed_by_name(self.designed_for(scenario.simulation, Loop.known(scenario)), scenario)
