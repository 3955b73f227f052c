"""A controller of an upright pendulum, for a hanging one.

The pendulum enters the equations of motion only as l r and l ṙ, and the flat outputs as ζ + l r. So a pendulum with the
direction r and the length l moves as one with −r and −l. A control law that is designed for the rod length −l and
observes −r and −ṙ therefore controls a hanging pendulum. Its K = (M + m_c) g/(M l) is negative: the pendulum swings
back instead of falling over, with the frequency √|K| instead of the rate √K.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_baselines.controllers.dual_mode import DualMode
from quadpend_baselines.controllers.flatness import Flatness
from quadpend_baselines.controllers.lqr import Lqr
from quadpend_baselines.controllers.mppi import Mppi
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.estimation.loop import Loop
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SIZE, OUTPUT_FEEDBACK_FIELDS

_MIRRORED = ("direction", "direction_rate")
_LAWS = (Flatness, Lqr, DualMode, Mppi)  # control laws that were tested with a hanging pendulum


def mirror_simulation(simulation: Simulation) -> Simulation:
    """Return a simulation with the rod length −l, for the design of control laws only.

    Raises:
        ValueError: If the vehicle is rigid.
    """
    if simulation.is_rigid:
        raise ValueError(
            f"controllers of a hanging pendulum are for the paper's vehicle, not {simulation.vehicle.name!r}"
        )
    return replace(simulation, pendulum="hanging")


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
        policy: `flatness`, `lqr`, `lqi`, `dual-mode` or `mppi`.
        simulation: Nominal simulation.
        loop: The known delays and lags of the loop; None: there are none.

    Raises:
        ValueError: If it is another controller, or the vehicle is rigid.
    """

    def __init__(self, policy: Any, simulation: Simulation, loop: Loop | None = None) -> None:
        """Design the controller."""
        if not isinstance(policy, OutputFeedback) or policy.make_law not in _LAWS:
            raise ValueError("of the classical controllers, only flatness, lqr, lqi, dual-mode and mppi fly a load")
        self.policy = policy.with_simulation(mirror_simulation(simulation), loop)

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
