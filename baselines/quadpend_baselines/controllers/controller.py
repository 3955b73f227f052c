"""The base class of the classical controllers: designed for a nominal simulation and the known part of its loop.

A hanging pendulum needs no controllers of its own. The pendulum enters the equations of motion only as l r and l ṙ, and
the flat outputs as ζ + l r. So a pendulum with the direction r and the length l moves as one with −r and −l. A control
law that is designed for the rod length −l and observes −r and −ṙ therefore controls a hanging pendulum. Its
K = (M + m_c) g/(M l) is negative: the pendulum swings back instead of falling over, with the frequency √|K| instead of
the rate √K.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_baselines.controllers.law import ObserverKind
from quadpend_baselines.estimation.feeding import fed_by_name
from quadpend_baselines.estimation.loop import READABLE, Loop
from quadpend_baselines.policy.protocol import Policy, PolicyWrapper
from quadpend_baselines.policy.told import for_told_pole
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.scenarios import Scenario
from quadpend_gym.tasks.observation import ObservationLayout


class Controller(Policy):
    """A classical controller of thrust and torques.

    Args:
        gains: Gains, or a function that returns them for a nominal simulation.
        simulation: Nominal plant, torque limits and control period; None: the default simulation.
        loop: The known delays and lags of the loop; None: there are none.

    Attributes:
        observer: What estimates the disturbance for hybrids on the controller.
        has_c: Whether the controller can be written as C.
        flies_load: Whether the controller, designed for a mirrored simulation, also flies a hanging pendulum.
    """

    observer: ObserverKind = "hidden"
    has_c: bool = False
    flies_load: bool = False
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
        """Return the controller designed for a scenario, its known loop, a hanging pendulum and poles that are told."""
        return for_told_pole(self._adapt, scenario)

    def _adapt(self, scenario: Scenario) -> Policy:
        simulation, loop = scenario.simulation, Loop.known(scenario)
        if scenario.task.pendulum != "hanging":
            return fed_by_name(self.designed_for(simulation, loop), scenario)
        if not self.flies_load:
            raise ValueError("of the classical controllers, only flatness, lqr, lqi and dual-mode fly a load")
        return fed_by_name(Hanging(self.designed_for(mirror_simulation(simulation), loop)), scenario)


def mirror_simulation(simulation: Simulation) -> Simulation:
    """Return a simulation of the paper's vehicle with the rod length −l, for the design of control laws only."""
    if simulation.vehicle.attitude == "rigid":
        raise ValueError(
            f"controllers of a hanging pendulum are for the paper's vehicle, not {simulation.vehicle.name!r}"
        )
    return replace(simulation, pendulum="hanging")


class Hanging(PolicyWrapper):
    """A controller that is designed for a simulation of `mirror_simulation`, for a hanging pendulum."""

    policy: Controller

    def observed(self, observation: Any) -> Any:
        """Return the observation with the opposite direction of the pendulum."""
        mirrored = np.array(observation, np.float32)
        layout = self.policy.loop.observation
        for name in {"direction", "direction_rate"} & set(layout):
            mirrored[..., layout.columns[name]] *= -1.0
        return mirrored
