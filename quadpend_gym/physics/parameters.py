"""Layout of the physical parameters in arrays, command limits and simulation settings."""

from dataclasses import dataclass, field, fields

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import check_positive, from_plain
from quadpend_gym.vehicles.parameters import PAPER as PAPER
from quadpend_gym.vehicles.parameters import Parameters as Parameters

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
