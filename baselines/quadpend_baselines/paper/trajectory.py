"""Recorded trajectories of the experiment, sampled in time."""

from dataclasses import dataclass

import numpy as np

from quadpend_gym import PAPER, State
from quadpend_gym.core.arrays import Floats


@dataclass(frozen=True)
class Trajectory:
    """A trajectory at m times.

    Attributes:
        time: s, shape (m,).
        state: See `quadpend_gym.physics.state`, shape (m, 18).
        reference: Derivatives of order 0 to 6 of F_x, F_y, z and ψ, shape (m, 7, 4).
        command: Thrust (N) and torques τφ, τθ, τψ (N·m), shape (m, 4).
        disturbance: The true disturbance, N and N·m, in the layout of `Disturbance`, shape (m, 9).
        estimate: The disturbance that the observers estimate, see `ADRC.estimated_disturbance`, shape (m, 9).
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
