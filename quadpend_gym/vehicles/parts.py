"""The parts of a vehicle: pole, rotors, drag, and the rate loop on board. SI units, body frame."""

from dataclasses import dataclass
from typing import Annotated, Any

from quadpend_gym.core.ranges import Range, check_fields
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

    mass: Annotated[float, Range(1e-5, 1e3, "kg")]  # m, kg
    length: Annotated[float, Range(0.01, 20.0, "m")]  # l, pivot to centre of mass
    inertia: float = 0.0  # J, kg·m², transverse, about the pole's own centre of mass; at most m extent²/4
    drag_area: Annotated[float, Range(0.0, 10.0, "m²")] = 0.0  # C_d A
    extent: float | None = None  # m, full length from the pivot; None: 2 l

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_fields(self, "pole.")
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

    # m, from the body's centre of mass; (x, y) means z = 0
    positions: Annotated[tuple[tuple[float, float, float], ...], Range(-10.0, 10.0, "m")]
    spins: tuple[int, ...]  # +1 or −1: sign of the yaw torque that the thrust of each rotor brings
    thrust: Annotated[tuple[float, float], Range(0.0, 1e4, "N")]  # lowest and highest thrust of each rotor
    torque_per_thrust: Annotated[float, Range(1e-5, 1.0, "m")]  # κ, yaw torque per thrust
    lag_up: Annotated[float, Range(0.0, 1.0, "s")] = 0.0  # time constant of a rising thrust
    lag_down: Annotated[float | None, Range(0.0, 1.0, "s")] = None  # time constant of a falling thrust; None: `lag_up`
    # J_p, kg·m², of one propeller and motor about its axis, for gyroscopic torques
    inertia: Annotated[float, Range(0.0, 1.0, "kg·m²")] = 0.0
    # thrust per squared speed; needed if inertia > 0
    thrust_coefficient: Annotated[float | None, Range(1e-12, 1.0, "N·s²/rad²")] = None

    def __post_init__(self) -> None:
        to_plain_fields(self)
        object.__setattr__(self, "positions", _positions(self.positions))
        object.__setattr__(self, "spins", _spins(self.spins))
        object.__setattr__(self, "thrust", check_interval(self.thrust, "rotors.thrust"))
        check_fields(self, "rotors.")
        if self.thrust_coefficient is None and self.inertia > 0.0:
            raise ValueError("rotors.thrust_coefficient must be given if rotors.inertia is above zero, not None")


def _positions(value: Any) -> tuple[tuple[float, ...], ...]:
    """Return four positions of three numbers."""
    if not isinstance(value, tuple) or len(value) != 4:
        raise TypeError(f"rotors.positions must be four positions (x, y) or (x, y, z), not {value!r}")
    rows = []
    for item in value:
        if not isinstance(item, tuple) or len(item) not in (2, 3):
            raise TypeError(f"rotors.positions must be four positions (x, y) or (x, y, z), not {value!r}")
        rows.append(tuple(check_number(number, "rotors.positions") for number in (*item, 0.0)[:3]))
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

    area: Annotated[float, Range(0.0, 100.0, "m²")] = 0.0  # C_d A of the quadratic drag, the same in all directions
    # linear drag along the body axes
    rotor: Annotated[tuple[float, float, float], Range(0.0, 100.0, "N·s/m")] = (0.0, 0.0, 0.0)
    # linear drag of the body rates
    angular: Annotated[tuple[float, float, float], Range(0.0, 100.0, "N·m·s/rad")] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        to_plain_fields(self)
        for name in ("rotor", "angular"):
            object.__setattr__(self, name, as_vector(getattr(self, name), 3, f"drag.{name}"))
        check_fields(self, "drag.")


@dataclass(frozen=True)
class RateLoop:
    """The loop on board that follows body rates; after `time_constant`, 63 % of a small step of a rate is reached.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is out of its range.
    """

    time_constant: Annotated[float, Range(1e-3, 1.0, "s")] = 0.02  # Hehn and D'Andrea (ICRA 2011) report about 0.02
    roll_pitch: Annotated[float, Range(0.1, 100.0, "rad/s")] = 10.0  # rate at an action of ±1
    yaw: Annotated[float, Range(0.1, 100.0, "rad/s")] = 3.0  # rate at an action of ±1

    def __post_init__(self) -> None:
        to_plain_fields(self)
        check_fields(self, "rate_loop.")
