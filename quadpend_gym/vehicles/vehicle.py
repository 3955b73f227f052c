"""A quadrotor with a pole as data: `Vehicle`, and what follows from its rotors.

Frames: world z up; body x forward, y left, z up, with its origin in the body's centre of mass. SI units.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.ranges import Range, check_fields
from quadpend_gym.core.validation import as_vector, check_number, from_plain, suggest, to_plain_fields
from quadpend_gym.vehicles.parameters import Parameters
from quadpend_gym.vehicles.parts import Drag, Pole, RateLoop, Rotors
from quadpend_gym.vehicles.poles import as_pole

ATTITUDES = ("rigid", "euler")
_MARGIN = 0.05  # share of the hover thrust that every rotor must have left in both senses
_LARGEST_GYRATION = 3.0  # radius of gyration per distance of the outermost rotor; 1 if all mass is at that distance
_FASTEST_LOOP = 0.5  # least time constant of the rate loop, as a share of the mean lag of the rotors


@dataclass(frozen=True)
class Vehicle:
    """A quadrotor that carries a pole on a ball joint.

    Every field may be given as plain data: a mapping for a part, lists for tuples, and for the pole also the name of
    one in `POLES`.

    Attributes:
        name: Name in tables and pictures.
        mass: M, kg, without the pole.
        inertia: (Ixx, Iyy, Izz) or 3 × 3, kg·m², body frame, about the body's centre of mass, without the pole. With
            rotors, its radii of gyration are at most 3 times the distance of the outermost rotor from the centre of
            mass. A body whose mass is nowhere further out than the rotors has at most 1 times this distance.
        pole: The pole.
        attitude: "rigid" for a rigid body; "euler" for the paper's model, in which a constant diagonal inertia
            multiplies the Euler-angle accelerations. "euler" has neither rotors nor a pivot offset nor a pole inertia.
        pivot: p, m, body frame, from the body's centre of mass to the joint.
        rotors: The rotors; None: thrust and torques act as they are commanded, and `torque` is needed.
        drag: Drag of the body.
        rate_loop: The loop on board for the interface "body_rates"; None means its default values.
        torque: (roll and pitch, yaw), N·m: torques at an action of ±1 of the interface "wrench"; None: as
            computed by `torque_limits`.
        gravity: g, m/s².

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of its range, the inertia belongs to no rigid body, or the rotors cannot hover or
            cannot make roll, pitch and yaw torques.
    """

    name: str
    mass: Annotated[float, Range(1e-3, 1e3, "kg")]
    inertia: Any
    pole: Pole
    attitude: Literal["rigid", "euler"] = "rigid"
    pivot: Annotated[tuple[float, float, float], Range(-2.0, 2.0, "m")] = (0.0, 0.0, 0.0)
    rotors: Rotors | None = None
    drag: Drag = field(default_factory=Drag)
    rate_loop: RateLoop = field(default_factory=RateLoop)
    torque: Annotated[tuple[float, ...] | None, Range(1e-6, 1e4, "N·m")] = None
    gravity: Annotated[float, Range(0.1, 100.0, "m/s²")] = 9.81

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "pole", as_pole(self.pole))
        set_field(self, "drag", from_plain(Drag, self.drag, "vehicle.drag"))
        set_field(self, "rate_loop", from_plain(RateLoop, self.rate_loop or RateLoop(), "vehicle.rate_loop"))
        if self.rotors is not None:
            set_field(self, "rotors", from_plain(Rotors, self.rotors, "vehicle.rotors"))
        to_plain_fields(self)
        if not isinstance(self.name, str) or not self.name:
            raise TypeError(f"vehicle.name must be a text, not {self.name!r}")
        if self.attitude not in ATTITUDES:
            raise ValueError(
                f"vehicle.attitude must be 'rigid' or 'euler', not {self.attitude!r}{suggest(self.attitude, ATTITUDES)}"
            )
        set_field(self, "pivot", as_vector(self.pivot, 3, "vehicle.pivot"))
        if self.torque is not None and (not isinstance(self.torque, tuple) or len(self.torque) != 2):
            raise TypeError(f"vehicle.torque must be a pair (roll and pitch, yaw) in N·m, not {self.torque!r}")
        check_fields(self, "vehicle.")
        set_field(self, "inertia", _check_inertia(self.inertia, self.mass))
        if self.torque is None and self.rotors is None:
            raise ValueError("vehicle.torque must be given for a vehicle without rotors, not None")
        if self.attitude == "euler":
            _check_euler(self)
        if self.rotors is not None:
            _check_rotors(self)

    @property
    def inertia_matrix(self) -> Floats:
        """The inertia as a matrix, kg·m², shape (3, 3)."""
        array = np.array(self.inertia)
        return np.diag(array) if array.ndim == 1 else array

    @property
    def weight(self) -> float:
        """Weight of body and pole, N: the hover thrust."""
        return (self.mass + self.pole.mass) * self.gravity

    @property
    def stiffness(self) -> float:
        """K = (M + m) g / (M' λ), 1/s²: an upright pole falls at the rate √K if the body stays level.

        λ is the pole's `equivalent_length`. M' = M + m − m l/λ includes the part of its mass that moves with the pivot.
        """
        length = self.pole.equivalent_length
        moved = self.mass + self.pole.mass * (1.0 - self.pole.length / length)
        return self.weight / (moved * length)

    @property
    def parameters(self) -> Parameters:
        """The nine physical parameters that every vehicle has; the inertia is the diagonal of the matrix."""
        roll, pitch, yaw = np.diag(self.inertia_matrix).tolist()
        return Parameters(
            quadrotor_mass=self.mass,
            bob_mass=self.pole.mass,
            rod_length=self.pole.length,
            gravity=self.gravity,
            inertia_roll=roll,
            inertia_pitch=pitch,
            inertia_yaw=yaw,
            quadrotor_drag_area=self.drag.area,
            bob_drag_area=self.pole.drag_area,
        )

    def with_pole(self, pole: Any) -> "Vehicle":
        """Return this vehicle with another pole: a `Pole`, a mapping of its fields, or the name of one in `POLES`."""
        return replace(self, pole=as_pole(pole))


def mixing(vehicle: Vehicle) -> Floats:
    """Return the matrix from the rotor thrusts to thrust and torques about x, y, z, N and N·m, shape (4, 4).

    Raises:
        ValueError: If the vehicle has no rotors.
    """
    rotors = _rotors(vehicle)
    x, y, _ = np.array(rotors.positions).T
    return np.array([np.ones(4), y, -x, rotors.torque_per_thrust * np.array(rotors.spins)])


def hover_wrench(parameters: Parameters, pivot: Sequence[float]) -> Floats:
    """Return thrust (N) and torques about x, y, z (N·m) that hold body and upright pole at rest, shape (4,).

    Args:
        parameters: Masses and gravity.
        pivot: p, m, body frame. Beside the centre of mass, the weight of the pole makes a torque.
    """
    pole, (x, y, _) = parameters.bob_mass * parameters.gravity, pivot
    return np.array([parameters.hover_thrust, y * pole, -x * pole, 0.0])


def hover_thrusts(vehicle: Vehicle) -> Floats:
    """Return the rotor thrusts that hold body and upright pole at rest, N, shape (4,).

    They make no torque, unless the pivot is beside the centre of mass.

    Raises:
        ValueError: If the vehicle has no rotors.
    """
    return np.asarray(np.linalg.solve(mixing(vehicle), hover_wrench(vehicle.parameters, vehicle.pivot)))


def torque_limits(vehicle: Vehicle) -> tuple[float, float]:
    """Return the torques at an action of ±1 of the interface "wrench": (roll and pitch, yaw), N·m.

    They are `Vehicle.torque` if it is given. Otherwise they are the largest torques about one axis, in both senses,
    that the rotors make at the hover thrust within their limits; the smaller of roll and pitch.
    """
    if vehicle.torque is not None:
        roll_pitch, yaw = vehicle.torque
        return roll_pitch, yaw
    low, high = _rotors(vehicle).thrust
    hover = hover_thrusts(vehicle)
    room = np.minimum(hover - low, high - hover)  # N, of each rotor, in both senses
    per_torque = np.abs(np.linalg.inv(mixing(vehicle))[:, 1:])  # N per N·m
    with np.errstate(divide="ignore"):
        roll, pitch, yaw = (room[:, np.newaxis] / per_torque).min(axis=0).tolist()
    return min(roll, pitch), yaw


def _rotors(vehicle: Vehicle) -> Rotors:
    if vehicle.rotors is None:
        raise ValueError(f"the vehicle {vehicle.name!r} has no rotors")
    return vehicle.rotors


def _check_inertia(value: Any, mass: float) -> tuple[Any, ...]:
    """Return an inertia as three numbers or three rows of three, after checking that a rigid body can have it."""
    wrong = f"vehicle.inertia must be three numbers or three rows of three numbers, kg·m², not {value!r}"
    if not isinstance(value, tuple) or len(value) != 3:
        raise TypeError(wrong)
    rows = value if all(isinstance(row, tuple) and len(row) == 3 for row in value) else (value,)
    if any(isinstance(number, tuple) for row in rows for number in row):
        raise TypeError(wrong)
    plain = tuple(tuple(check_number(number, "vehicle.inertia") for number in row) for row in rows)
    matrix = np.diag(plain[0]) if len(plain) == 1 else np.array(plain)
    if np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
        raise ValueError(f"vehicle.inertia must be symmetric, not {value!r}")
    least, middle, largest = np.linalg.eigvalsh(matrix).tolist()
    if least <= 0.0:
        raise ValueError(f"vehicle.inertia must be positive definite, not {value!r}")
    if largest > (least + middle) * (1.0 + 1e-9):
        raise ValueError(
            "vehicle.inertia must have principal moments of which none exceeds the sum of the others, not"
            f" {least:g}, {middle:g} and {largest:g} kg·m²"
        )
    low, high = 1e-3, 10.0
    if not (mass * low**2 <= least and largest <= mass * high**2):
        raise ValueError(
            f"vehicle.inertia must be between {mass * low**2:g} and {mass * high**2:g} kg·m² for a mass of {mass:g} kg"
            f" (radii of gyration from {low:g} to {high:g} m), not {value!r}"
        )
    return plain[0] if len(plain) == 1 else plain


def _check_euler(vehicle: Vehicle) -> None:
    """Refuse what the paper's attitude model does not have."""
    absent = {
        "rotors": vehicle.rotors is not None,
        "pivot": any(vehicle.pivot),
        "rate_loop": vehicle.rate_loop != RateLoop(),
        "pole.inertia": vehicle.pole.inertia > 0.0,
        "drag.rotor": any(vehicle.drag.rotor),
        "drag.angular": any(vehicle.drag.angular),
        "inertia with products of inertia": isinstance(vehicle.inertia[0], tuple),
    }
    if given := [name for name, is_given in absent.items() if is_given]:
        raise ValueError(f"vehicle.attitude 'euler', the paper's model, has no {given[0]}; take 'rigid'")


def _check_rotors(vehicle: Vehicle) -> None:
    """Refuse rotors that cannot hover or cannot make roll, pitch and yaw torques."""
    rotors = _rotors(vehicle)
    low, high = rotors.thrust
    weight = f"the weight of {vehicle.weight:g} N of body and pole"
    if 4.0 * high <= vehicle.weight:
        raise ValueError(f"rotors.thrust must carry {weight}, not at most {high:g} N by each of four rotors")
    if 4.0 * low >= vehicle.weight:
        raise ValueError(f"rotors.thrust must allow less than {weight}, not at least {low:g} N by each of four rotors")
    scaled = mixing(vehicle)
    scaled[1:3] /= max(np.abs(rotors.positions).max(), 1e-12)
    scaled[3] /= rotors.torque_per_thrust
    if np.linalg.svd(scaled, compute_uv=False)[-1] < 1e-3:
        raise ValueError(
            "rotors.positions and rotors.spins must make thrust, roll, pitch and yaw torques independently of each"
            f" other (for example neighbours with opposite spins), not {rotors.positions!r} with {rotors.spins!r}"
        )
    hover = hover_thrusts(vehicle)
    if not (low < (1.0 - _MARGIN) * hover.min() and (1.0 + _MARGIN) * hover.max() < high):
        raise ValueError(
            f"rotors.positions, rotors.spins and pivot must allow hover within rotors.thrust of {low:g} to {high:g} N"
            f" and a margin of {_MARGIN:.0%}, not with the thrusts {', '.join(f'{thrust:.3g}' for thrust in hover)} N"
        )
    _check_gyration(vehicle, rotors)
    lag = 0.5 * (rotors.lag_up + (rotors.lag_up if rotors.lag_down is None else rotors.lag_down))
    if vehicle.rate_loop is not None and vehicle.rate_loop.time_constant < _FASTEST_LOOP * lag:
        raise ValueError(
            f"rate_loop.time_constant must be at least half the rotors' lag of {lag:g} s, not"
            f" {vehicle.rate_loop.time_constant:g} s"
        )


def _check_gyration(vehicle: Vehicle, rotors: Rotors) -> None:
    """Refuse an inertia that is much too large for the size of the vehicle."""
    reach = float(np.linalg.norm(rotors.positions, axis=1).max())
    most = vehicle.mass * (_LARGEST_GYRATION * reach) ** 2
    if np.linalg.eigvalsh(vehicle.inertia_matrix)[-1] > most:
        raise ValueError(
            f"vehicle.inertia must be at most {most:.3g} kg·m² (a radius of gyration of {_LARGEST_GYRATION:g} times the"
            f" {reach:.3g} m to the outermost rotor), not {vehicle.inertia!r}, which may be in g·m² or g·cm²"
        )
