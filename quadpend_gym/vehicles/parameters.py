"""The nine physical parameters that every vehicle has.

The default values come from Table 1 of the paper; `quadpend_gym.physics.drag` gives the source of the drag areas.
"""

from dataclasses import astuple, dataclass
from typing import Annotated

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.ranges import Range, check_fields


@dataclass(frozen=True)
class Parameters:
    """Physical parameters of a quadrotor with constant diagonal inertia, a massless rod and a point mass as bob.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is outside its range.
    """

    quadrotor_mass: Annotated[float, Range(1e-4, 1e4, "kg")] = 0.5  # M, Table 1
    bob_mass: Annotated[float, Range(1e-6, 1e4, "kg")] = 0.2  # m_c, Table 1
    rod_length: Annotated[float, Range(1e-3, 100.0, "m")] = 0.3  # l, Table 1
    gravity: Annotated[float, Range(0.01, 1000.0, "m/s²")] = 9.8  # g, Table 1
    inertia_roll: Annotated[float, Range(1e-10, 1e6, "kg·m²")] = 0.1  # I_φ, Table 1
    inertia_pitch: Annotated[float, Range(1e-10, 1e6, "kg·m²")] = 0.1  # I_θ, Table 1
    inertia_yaw: Annotated[float, Range(1e-10, 1e6, "kg·m²")] = 0.1  # I_ψ, Table 1
    quadrotor_drag_area: Annotated[float, Range(0.0, 100.0, "m²")] = 0.01  # A_Q, see `quadpend_gym.physics.drag`
    bob_drag_area: Annotated[float, Range(0.0, 100.0, "m²")] = 0.0005  # A_B, see `quadpend_gym.physics.drag`

    def __post_init__(self) -> None:
        check_fields(self)

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
        """Return the fields in order as an array of shape (9,), SI units."""
        return np.array(astuple(self))


PAPER = Parameters()
