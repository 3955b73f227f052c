"""A controller of an upright pendulum, for a hanging one.

The pendulum enters the equations of motion only as l r and l ṙ, and the flat outputs as ζ + l r. So a pendulum with the
direction r and the length l moves as one with −r and −l. A control law that is designed for the rod length −l and
observes −r and −ṙ therefore controls a hanging pendulum. Its K = (M + m_c) g/(M l) is negative: the pendulum swings
back instead of falling over, with the frequency √|K| instead of the rate √K.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from quadpend_baselines.policy.protocol import PolicyWrapper
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.physics.plants import RigidPlant, plant_of
from quadpend_gym.tasks.observation import OBSERVATION_FIELDS, OBSERVATION_SIZE, OUTPUT_FEEDBACK_FIELDS


def mirror_simulation(simulation: Simulation) -> Simulation:
    """Return a simulation of the paper's vehicle with the rod length −l, for the design of control laws only."""
    if isinstance(plant_of(simulation), RigidPlant):
        raise ValueError(
            f"controllers of a hanging pendulum are for the paper's vehicle, not {simulation.vehicle.name!r}"
        )
    return replace(simulation, pendulum="hanging")


class Hanging(PolicyWrapper):
    """A controller that is designed for a simulation of `mirror_simulation`, for a hanging pendulum."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats32, Any]:
        """Return action and memory; see `Policy.predict`."""
        mirrored = np.array(observation, np.float32)
        fields = OBSERVATION_FIELDS if mirrored.shape[-1] == OBSERVATION_SIZE else OUTPUT_FEEDBACK_FIELDS
        for name in fields.keys() & {"direction", "direction_rate"}:
            mirrored[..., fields[name]] *= -1.0
        return self.policy.predict(mirrored, state, episode_start, deterministic)
