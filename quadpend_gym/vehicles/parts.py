"""The parts of a vehicle: pole, rotors, drag, and the rate loop on board. SI units, body frame."""

from dataclasses import dataclass
from typing import Any

from quadpend_gym.core.validation import as_vector, check_interval, check_number, to_plain_fields


@dataclass(frozen=True)
class Pole:
    """A rigid pole on a ball joint without friction. It has no inertia about its own axis.

    It moves like a point mass m l/λ at the distance λ = (J + m l²)/(m l) from the pivot, see `equivalent_length`, with
    the rest of its mass in the pivot.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is out of its range.
    """

    mass: float  # m, kg, 10⁻⁵ to 10³
    length: float  # l, m, pivot to centre of mass, 0.01 to 20
    inertia: float = 0.0  # J, kg·m², transverse, about the pole's own centre of mass; at most m extent²/4
    drag_area: float = 0.0  # m², C_d A, at most 10
    extent: float | None = None  # m, full length from the pivot; None: 2 l

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_number(self.mass, "pole.mass", 1e-5, 1e3, "kg")
        check_number(self.length, "pole.length", 0.01, 20.0, "m")
        check_number(self.drag_area, "pole.drag_area", 0.0, 10.0, "m²")
        if self.extent is not None:
            check_number(self.extent, "pole.extent", self.length, 40.0, "m")
        extent = 2.0 * self.length if self.extent is None else self.extent
        check_number(self.inertia, "pole.inertia", 0.0, 0.25 * self.mass * extent**2, "kg·m²")

    @property
    def equivalent_length(self) -> float:
        """λ = (J + m l²)/(m l), m: the length of the massless rod with a point mass that swings at the same rate."""
        return self.length + self.inertia / (self.mass * self.length)


@dataclass(frozen=True)
class Rotors:
    """Four rotors that push along the body's z axis.

    Rotor i with the thrust f at (x, y) brings the torques (y f, −x f, spin κ f). The presets count the rotors
    counter-clockwise seen from above: front, left, back, right in the plus layout, and front left, back left, back
    right, front right in the X layout.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of its range.
    """

    positions: tuple[
        tuple[float, float, float], ...
    ]  # m, from the body's centre of mass; (x, y) means z = 0; within ±10
    spins: tuple[int, ...]  # +1 or −1: sign of the yaw torque that the thrust of each rotor brings
    thrust: tuple[float, float]  # N, lowest and highest thrust of each rotor, 0 to 10⁴
    torque_per_thrust: float  # κ, m, yaw torque per thrust, 10⁻⁵ to 1
    lag_up: float = 0.0  # s, time constant of a rising thrust, at most 1
    lag_down: float | None = None  # s, time constant of a falling thrust, at most 1; None: `lag_up`
    inertia: float = 0.0  # J_p, kg·m², of one propeller and motor about its axis, for gyroscopic torques; at most 1
    thrust_coefficient: float | None = None  # N·s²/rad², thrust per squared speed; needed if inertia > 0

    def __post_init__(self) -> None:
        to_plain_fields(self)
        object.__setattr__(self, "positions", _positions(self.positions))
        object.__setattr__(self, "spins", _spins(self.spins))
        object.__setattr__(self, "thrust", check_interval(self.thrust, "rotors.thrust", 0.0, 1e4, "N"))
        check_number(self.torque_per_thrust, "rotors.torque_per_thrust", 1e-5, 1.0, "m")
        check_number(self.lag_up, "rotors.lag_up", 0.0, 1.0, "s")
        if self.lag_down is not None:
            check_number(self.lag_down, "rotors.lag_down", 0.0, 1.0, "s")
        check_number(self.inertia, "rotors.inertia", 0.0, 1.0, "kg·m²")
        if self.thrust_coefficient is not None:
            check_number(self.thrust_coefficient, "rotors.thrust_coefficient", 1e-12, 1.0, "N·s²/rad²")
        elif self.inertia > 0.0:
            raise ValueError("rotors.thrust_coefficient must be given if rotors.inertia is above zero, not None")


def _positions(value: Any) -> tuple[tuple[float, ...], ...]:
    """Return four positions of three numbers."""
    if not isinstance(value, tuple) or len(value) != 4:
        raise TypeError(f"rotors.positions must be four positions (x, y) or (x, y, z), not {value!r}")
    rows = []
    for item in value:
        if not isinstance(item, tuple) or len(item) not in (2, 3):
            raise TypeError(f"rotors.positions must be four positions (x, y) or (x, y, z), not {value!r}")
        rows.append(tuple(check_number(number, "rotors.positions", -10.0, 10.0, "m") for number in (*item, 0.0)[:3]))
    return tuple(rows)


def _spins(value: Any) -> tuple[int, ...]:
    """Return four signs."""
    if not isinstance(value, tuple) or len(value) != 4 or not all(item in (-1, 1) for item in value):
        raise ValueError(f"rotors.spins must be four numbers +1 or -1, not {value!r}")
    return tuple(int(item) for item in value)


@dataclass(frozen=True)
class Drag:
    """Drag of the body, computed from its velocity relative to the air.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is negative or too large.
    """

    area: float = 0.0  # m², C_d A of the quadratic drag, the same in all directions, at most 100
    rotor: tuple[float, float, float] = (0.0, 0.0, 0.0)  # N·s/m, linear drag along the body axes, at most 100
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0)  # N·m·s/rad, linear drag of the body rates, at most 100

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_number(self.area, "drag.area", 0.0, 100.0, "m²")
        for name, unit in (("rotor", "N·s/m"), ("angular", "N·m·s/rad")):
            vector = as_vector(getattr(self, name), 3, f"drag.{name}")
            object.__setattr__(self, name, tuple(check_number(x, f"drag.{name}", 0.0, 100.0, unit) for x in vector))


@dataclass(frozen=True)
class RateLoop:
    """The loop on board that follows body rates; after `time_constant`, 63 % of a small step of a rate is reached.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is out of its range.
    """

    time_constant: float = 0.02  # s, 0.001 to 1; Hehn and D'Andrea (ICRA 2011) report about 0.02
    roll_pitch: float = 10.0  # rad/s, rate at an action of ±1, 0.1 to 100
    yaw: float = 3.0  # rad/s, rate at an action of ±1, 0.1 to 100

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_number(self.time_constant, "rate_loop.time_constant", 1e-3, 1.0, "s")
        check_number(self.roll_pitch, "rate_loop.roll_pitch", 0.1, 100.0, "rad/s")
        check_number(self.yaw, "rate_loop.yaw", 0.1, 100.0, "rad/s")
