"""A recorded trajectory, from whichever simulation it came."""

from dataclasses import dataclass

import numpy as np

from quadpend_gym import PAPER, State
from quadpend_gym.core.arrays import Floats


@dataclass(frozen=True)
class Trajectory:
    """A trajectory, sampled in time.

    Attributes:
        time: s, shape (m,).
        state: shape (m, 18), see `quadpend_gym.physics.state`.
        reference: derivatives of order 0 to 6 of F_x, F_y, z and ψ, shape (m, 7, 4).
        command: thrust (N) and torques τφ, τθ, τψ (N·m), shape (m, 4).
        disturbance: the true one, shape (m, 9), see `quadpend_gym.wind`.
        estimate: the same as the observers see it, shape (m, 9), see `ADRC.estimated_disturbance`.
    """

    time: Floats
    state: Floats
    reference: Floats
    command: Floats
    disturbance: Floats
    estimate: Floats

    @property
    def outputs(self) -> Floats:
        """F_x, F_y, z (m) and ψ (rad), shape (m, 4)."""
        s = State(self.state)
        bob = s.position + PAPER.rod_length * s.direction
        return np.column_stack([bob[:, :2], s.position[:, 2], s.euler[:, 2]])

    @property
    def error(self) -> Floats:
        """Tracking errors of F_x, F_y, z (m) and ψ (rad), shape (m, 4)."""
        return np.asarray(self.outputs - self.reference[:, 0])
