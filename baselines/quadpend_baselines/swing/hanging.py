"""A controller of an upright pendulum, for a hanging one.

The pendulum enters the equations of motion only as l r and l ṙ, and the flat outputs as ζ + l r. So a pendulum with the
direction r and the length l moves as one with −r and −l. A control law that is designed for the rod length −l and
observes −r and −ṙ therefore controls a hanging pendulum. Its K = (M + m_c) g/(M l) is negative: the pendulum swings
back instead of falling over, with the frequency √|K| instead of the rate √K.
"""

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_baselines.estimation.loop import Loop, design_for
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SIZE, OUTPUT_FEEDBACK_FIELDS

_MIRRORED = ("direction", "direction_rate")


def mirror_simulation(simulation: Simulation) -> Simulation:
    """Return a simulation with the rod length −l, for the design of control laws only."""
    parameters = copy(simulation.parameters)
    object.__setattr__(parameters, "rod_length", -parameters.rod_length)  # outside the range of a rod
    return replace(simulation, parameters=parameters)


def mirror_observation(observation: Floats32) -> Floats32:
    """Return observations, shape (..., 36) or (..., 27), with −r and −ṙ in place of r and ṙ."""
    out = np.array(observation, np.float32)
    fields = OBSERVATION_FIELDS if out.shape[-1] == OBSERVATION_SIZE else OUTPUT_FEEDBACK_FIELDS
    for name in _MIRRORED:
        if name in fields:
            out[..., fields[name]] *= -1.0
    return out


class Hanging:
    """A controller of an upright pendulum, designed for a hanging one.

    Args:
        policy: Controller with the method `with_simulation`.
        simulation: Nominal simulation.
        loop: The known delays and lags of the loop; None: there are none.
    """

    def __init__(self, policy: Any, simulation: Simulation, loop: Loop | None = None) -> None:
        """Design the controller."""
        self.policy = design_for(policy, mirror_simulation(simulation), loop or Loop())

    def with_simulation(self, simulation: Simulation, loop: Loop | None = None) -> "Hanging":
        """Return the same controller, designed for another nominal simulation and loop."""
        return Hanging(self.policy, simulation, loop)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        action, memory = self.policy.predict(mirror_observation(observation), state, episode_start, deterministic)
        return action, memory

    def estimated_disturbance(self, memory: Any) -> Floats:
        """Return the estimated disturbance, N and N·m, shape (n, 9)."""
        return np.asarray(self.policy.estimated_disturbance(memory))
