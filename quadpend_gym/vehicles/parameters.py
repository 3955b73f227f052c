"""The nine physical parameters that every vehicle has.

The default values come from Table 1 of the paper; `quadpend_gym.physics.drag` gives the source of the drag areas.
"""

from dataclasses import astuple, dataclass, fields

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import check_number, check_positive


@dataclass(frozen=True)
class Parameters:
    """Physical parameters of a quadrotor with constant diagonal inertia, a massless rod and a point mass as bob.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is not finite, a drag area is negative, or another value is not above zero.
    """

    quadrotor_mass: float = 0.5  # M, kg, Table 1
    bob_mass: float = 0.2  # m_c, kg, Table 1
    rod_length: float = 0.3  # l, m, Table 1
    gravity: float = 9.8  # g, m/s², Table 1
    inertia_roll: float = 0.1  # I_φ, kg·m², Table 1
    inertia_pitch: float = 0.1  # I_θ, kg·m², Table 1
    inertia_yaw: float = 0.1  # I_ψ, kg·m², Table 1
    quadrotor_drag_area: float = 0.01  # A_Q, m², see `quadpend_gym.physics.drag`
    bob_drag_area: float = 0.0005  # A_B, m², see `quadpend_gym.physics.drag`

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name.endswith("drag_area"):
                check_number(getattr(self, item.name), item.name, 0.0)
            else:
                check_positive(getattr(self, item.name), item.name)

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
