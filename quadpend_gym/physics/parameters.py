"""Physical parameters, command limits and simulation settings.

The default values come from Table 1 of the paper; `quadpend_gym.physics.drag` gives the source of the drag areas.
"""

from dataclasses import astuple, dataclass, field, fields

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import check_number, check_positive, from_plain


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
PARAMETER_NAMES = tuple(item.name for item in fields(Parameters))
PARAMETERS_SIZE = len(PARAMETER_NAMES)
# Position of each parameter in `Parameters.as_array`, as constants that compiled functions can read.
(
    QUADROTOR_MASS,
    BOB_MASS,
    ROD_LENGTH,
    GRAVITY,
    INERTIA_ROLL,
    INERTIA_PITCH,
    INERTIA_YAW,
    QUADROTOR_DRAG_AREA,
    BOB_DRAG_AREA,
) = range(PARAMETERS_SIZE)
CONTROL_PERIOD = 0.01  # s: the control loop runs at 100 Hz


@dataclass(frozen=True)
class Actuators:
    """Torque limits: the torques that an action of ±1 commands. `Simulation` derives the thrust limit from the weight.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is not finite or not above zero.
    """

    roll_pitch_torque: float = 5.0  # N·m; by default τφ = 5 a₁ and τθ = 5 a₂
    yaw_torque: float = 1.0  # N·m; by default τψ = a₃

    def __post_init__(self) -> None:
        for item in fields(self):
            check_positive(getattr(self, item.name), item.name)


@dataclass(frozen=True)
class Simulation:
    """Physical parameters, command limits, and step sizes of the simulation.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of range.
    """

    parameters: Parameters = PAPER
    actuators: Actuators = field(default_factory=Actuators)
    period: float = CONTROL_PERIOD  # s, control period
    substeps: int = 2  # Runge–Kutta steps in a control period

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", from_plain(Parameters, self.parameters, "parameters"))
        object.__setattr__(self, "actuators", from_plain(Actuators, self.actuators, "actuators"))
        check_positive(self.period, "period")
        if not isinstance(self.substeps, int) or self.substeps < 1:
            raise ValueError(f"substeps must be a whole number of at least 1, not {self.substeps!r}")

    @property
    def command_scale(self) -> Floats:
        """Scales that convert an action a to a command, shape (4,).

        The thrust is scale₀ (1 + a₀) in N and the torques are scaleᵢ aᵢ in N·m. scale₀ is the weight, so a zero action
        commands the hover thrust and no torques.
        """
        a = self.actuators
        return np.array([self.parameters.hover_thrust, a.roll_pitch_torque, a.roll_pitch_torque, a.yaw_torque])
