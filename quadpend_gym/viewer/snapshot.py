"""What a picture shows of one sub-environment at one instant."""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import State
from quadpend_gym.tasks.references import Reference


class Snapshot(NamedTuple):
    """One sub-environment at one instant; all vectors are in the world frame.

    Attributes:
        time: since the episode began, s.
        state: see `quadpend_gym.physics.state`.
        rod_length: m.
        reference: see `quadpend_gym.tasks.references`.
        disturbance: force on the quadrotor and on the bob, N, and torque, N·m, of the last step, shape (9,).
        thrust: of the last step, over the weight.
        error: norm of the tracking error, m.
        tilt: of the pendulum from upright, rad.
        tilt_limit: where an episode ends, rad.
        episode_return: the sum of the rewards.
        focus: where the camera looks, m, shape (3,).
        trail: where the bob was, the latest last, m, shape (k, 3).
        drift: how far the wind has carried the air's streaks, m, shape (3,).
        spin: of the rotors, rad.
    """

    time: float
    state: State
    rod_length: float
    reference: Reference
    disturbance: Floats
    thrust: float
    error: float
    tilt: float
    tilt_limit: float
    episode_return: float
    focus: Floats
    trail: Floats
    drift: Floats
    spin: float

    @property
    def bob(self) -> Floats:
        """The bob's position, m, shape (3,)."""
        return np.asarray(self.state.position + self.rod_length * self.state.direction)
