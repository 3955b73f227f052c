"""The parts of a vehicle: pole, rotors, drag, and the rate loop on board. SI units, body frame."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator

from quadpend_gym.core.files import read_toml
from quadpend_gym.core.settings import Parsed, Range, look_up, parse, settings

__all__ = ["POLES", "Drag", "Pole", "RateLoop", "Rotors"]

PRESETS = read_toml(Path(__file__).with_name("presets.toml"))
Axes = tuple[float, float, float]  # x, y, z
Position = Annotated[  # (x, y) means z = 0
    Axes, BeforeValidator(lambda value: (*value, 0.0)[:3], json_schema_input_type=Axes | tuple[float, float])
]


@settings
class Pole:
    """A rigid pole on a ball joint without friction. It has no inertia about its own axis.

    It moves like a point mass m l/λ at the distance λ = (J + m l²)/(m l) from the pivot, see `equivalent_length`, with
    the rest of its mass in the pivot.
    """

    mass: Annotated[float, Range(1e-5, 1e3, "kg")]  # mass m
    length: Annotated[float, Range(0.01, 20.0, "m")]  # distance l from the pivot to the pole's centre of mass
    # moment of inertia J about a perpendicular axis through the centre of mass; at most m extent²/4
    inertia: Annotated[float, Range(0.0, 4e5, "kg·m²")] = 0.0
    drag_area: Annotated[float, Range(0.0, 10.0, "m²")] = 0.0  # drag coefficient times area, C_d A
    extent: Annotated[float | None, Range(0.01, 40.0, "m")] = None  # full length from the pivot; None: twice `length`

    def __post_init__(self) -> None:
        extent = self.full_length
        if extent < self.length:
            raise ValueError(f"pole.extent must be at least the length of {self.length:g} m, not {extent:g} m")
        if self.inertia > 0.25 * self.mass * extent**2:
            most = 0.25 * self.mass * extent**2
            raise ValueError(f"pole.inertia must be at most {most:.3g} kg·m² (m extent²/4), not {self.inertia:g}")

    @property
    def full_length(self) -> float:
        """The distance from the pivot to the tip, m."""
        return 2.0 * self.length if self.extent is None else self.extent

    @property
    def equivalent_length(self) -> float:
        """λ = (J + m l²)/(m l), m: the length of the massless rod with a point mass that swings at the same rate."""
        return self.length + self.inertia / (self.mass * self.length)


POLES = {name: parse(Pole, data, f"poles.{name}") for name, data in PRESETS["poles"].items()}


# annotation of a field that holds a pole: from itself, its name, or a mapping of its fields
PoleField = Parsed(
    lambda value: look_up(POLES, value, "pole") if isinstance(value, str) else parse(Pole, value, "pole"),
    lambda: Literal[tuple(POLES)] | Pole,
)


@settings
class Rotors:
    """Four rotors that push along the body's z axis.

    Rotor i with the thrust f at (x, y) brings the torques (y f, −x f, spin κ f). The presets count the rotors
    counter-clockwise seen from above: front, left, back, right in the plus layout, and front left, back left, back
    right, front right in the X layout.
    """

    # (x, y) or (x, y, z) of each rotor, from the body's centre of mass
    positions: Annotated[tuple[Position, Position, Position, Position], Range(-10.0, 10.0, "m")]
    spins: tuple[Literal[-1, 1], Literal[-1, 1], Literal[-1, 1], Literal[-1, 1]]  # sign of the yaw torque of a thrust
    thrust: Annotated[tuple[float, float], Range(0.0, 1e4, "N")]  # lowest and highest thrust of each rotor
    torque_per_thrust: Annotated[float, Range(1e-5, 1.0, "m")]  # κ, yaw torque divided by thrust
    lag_up: Annotated[float, Range(0.0, 1.0, "s")] = 0.0  # time constant of a rising thrust
    lag_down: Annotated[float | None, Range(0.0, 1.0, "s")] = None  # time constant of a falling thrust; None: `lag_up`
    # moment of inertia J_p of one propeller with its motor about its axis, for gyroscopic torques
    inertia: Annotated[float, Range(0.0, 1.0, "kg·m²")] = 0.0
    # thrust divided by the squared speed; needed if `inertia` is above 0
    thrust_coefficient: Annotated[float | None, Range(1e-12, 1.0, "N·s²/rad²")] = None

    def __post_init__(self) -> None:
        if self.thrust[0] > self.thrust[1]:
            raise ValueError(f"rotors.thrust must be (lowest, highest), not {self.thrust}")
        if self.thrust_coefficient is None and self.inertia > 0.0:
            raise ValueError("rotors.thrust_coefficient must be given if rotors.inertia is above zero")

    @property
    def lags(self) -> tuple[float, float]:
        """Time constants of a rising and of a falling thrust, s."""
        return self.lag_up, self.lag_up if self.lag_down is None else self.lag_down


@settings
class Drag:
    """Drag of the body, computed from its velocity relative to the air."""

    # drag coefficient times area, C_d A, of the quadratic drag, the same in all directions
    area: Annotated[float, Range(0.0, 100.0, "m²")] = 0.0
    # force per velocity along the body axes, linear drag of the rotors
    rotor: Annotated[Axes, Range(0.0, 100.0, "N·s/m")] = (0.0, 0.0, 0.0)
    # torque per body rate about the body axes
    angular: Annotated[Axes, Range(0.0, 100.0, "N·m·s/rad")] = (0.0, 0.0, 0.0)
    # height above the centre of mass at which the drag of `rotor` acts
    height: Annotated[float, Range(-2.0, 2.0, "m")] = 0.0


@settings
class RateLoop:
    """The loop on board that follows body rates; after `time_constant`, 63 % of a small step of a rate is reached."""

    # time of 63 % of a small step; Hehn and D'Andrea (ICRA 2011) report about 0.02
    time_constant: Annotated[float, Range(1e-3, 1.0, "s")] = 0.02
    roll_pitch: Annotated[float, Range(0.1, 100.0, "rad/s")] = 10.0  # roll or pitch rate at an action of ±1
    yaw: Annotated[float, Range(0.1, 100.0, "rad/s")] = 3.0  # yaw rate at an action of ±1
