"""The nine physical parameters that every vehicle has, and their layout in arrays that compiled functions read."""

from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats

__all__ = ["PARAMETER_NAMES", "Parameters"]


class Parameters(NamedTuple):
    """Physical parameters of a quadrotor with a massless rod and a point mass as bob, SI units.

    `Vehicle.parameters` derives them from a vehicle. A pole with inertia has more, see `quadpend_gym.vehicles.Pole`.
    """

    quadrotor_mass: float  # M, kg
    bob_mass: float  # m_c, kg
    rod_length: float  # l, m
    gravity: float  # g, m/s²
    inertia_roll: float  # I_φ, kg·m²
    inertia_pitch: float  # I_θ, kg·m²
    inertia_yaw: float  # I_ψ, kg·m²
    quadrotor_drag_area: float  # A_Q, m², see `quadpend_gym.physics.drag`
    bob_drag_area: float  # A_B, m², see `quadpend_gym.physics.drag`

    @property
    def total_mass(self) -> float:
        """Total mass M + m_c, kg."""
        return self.quadrotor_mass + self.bob_mass

    @property
    def hover_thrust(self) -> float:
        """Thrust (M + m_c) g that balances the weight, N."""
        return self.total_mass * self.gravity

    @property
    def chain_stiffness(self) -> float:
        """K = (M + m_c) g / (M l), 1/s²; near hover r̈_x = K (r_x − θ), equation (26) of the paper."""
        return self.hover_thrust / (self.quadrotor_mass * self.rod_length)

    def as_array(self) -> Floats:
        """Return the parameters in order, shape (9,)."""
        return np.array(self)


PARAMETER_NAMES = Parameters._fields
PARAMETERS_SIZE = len(PARAMETER_NAMES)
QUADROTOR_MASS, BOB_MASS, ROD_LENGTH = range(3)  # positions in an array, for compiled functions
