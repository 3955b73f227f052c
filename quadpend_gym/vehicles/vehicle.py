"""A quadrotor with a pole as data: `Vehicle`, what follows from its rotors, and the vehicles of `presets.toml`.

Frames: world z up; body x forward, y left, z up, with its origin in the body's centre of mass. SI units.
"""

import re
from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.files import read_toml
from quadpend_gym.core.settings import Parsed, Range, look_up, parse, settings
from quadpend_gym.vehicles.family import random_vehicle
from quadpend_gym.vehicles.parameters import Parameters
from quadpend_gym.vehicles.parts import PRESETS, Axes, Drag, Pole, PoleField, RateLoop, Rotors

__all__ = ["VEHICLES", "Vehicle", "as_vehicle", "hover_thrusts", "hover_wrench", "mixing", "rotors_of", "torque_limits"]

_MARGIN = 0.05  # share of the hover thrust that every rotor must have left in both senses
_RANDOM = r"^random:\d+$"  # a vehicle of `family`
FASTEST_LOOP = 0.5  # least time constant of the rate loop, as a share of the mean lag of the rotors


@settings
class Vehicle:
    """A quadrotor that carries a pole on a ball joint.

    Every field may be given as plain data: a mapping for a part, lists for tuples, and for the pole also the name of
    one in `POLES`.
    """

    mass: Annotated[float, Range(1e-3, 1e3, "kg")]  # mass M of the body, without the pole
    # (Ixx, Iyy, Izz) or a 3 × 3 matrix, body frame, about the body's centre of mass, without the pole
    inertia: Annotated[Axes | tuple[Axes, Axes, Axes], Range(-1e6, 1e6, "kg·m²")]
    pole: Annotated[Pole, PoleField]
    name: str = "own"  # a vehicle from a file without a name has the name of the file
    # "euler": the paper's model, in which a constant diagonal inertia multiplies the Euler-angle accelerations
    attitude: Literal["rigid", "euler"] = "rigid"
    # position p of the joint, from the body's centre of mass
    pivot: Annotated[Axes, Range(-2.0, 2.0, "m")] = (0.0, 0.0, 0.0)
    rotors: Rotors | None = None  # None: thrust and torques act as they are commanded, and `torque` is needed
    drag: Drag = field(default_factory=Drag)
    rate_loop: RateLoop = field(default_factory=RateLoop)
    # torques (roll and pitch, yaw) of an action of ±1 with the interface "wrench"; None: from `torque_limits`
    torque: Annotated[tuple[float, float] | None, Range(1e-6, 1e4, "N·m")] = None
    gravity: Annotated[float, Range(0.1, 100.0, "m/s²")] = 9.81  # gravitational acceleration

    def __post_init__(self) -> None:
        _check_inertia(self)
        if self.torque is None and self.rotors is None:
            raise ValueError("vehicle.torque must be given for a vehicle without rotors")
        if self.attitude == "euler":
            _check_euler(self)
        if self.rotors is not None:
            _check_rotors(self, self.rotors)

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


def mixing(vehicle: Vehicle) -> Floats:
    """Return the matrix from the rotor thrusts to thrust and torques about x, y, z, N and N·m, shape (4, 4)."""
    rotors = rotors_of(vehicle)
    x, y, _ = np.array(rotors.positions).T
    return np.array([np.ones(4), y, -x, rotors.torque_per_thrust * np.array(rotors.spins)])


def hover_wrench(parameters: Parameters, pivot: Sequence[float]) -> Floats:
    """Return thrust (N) and torques about x, y, z (N·m) that hold body and upright pole at rest, shape (4,).

    If the pivot p (m, body frame) is beside the centre of mass, the weight of the pole makes a torque.
    """
    pole, (x, y, _) = parameters.bob_mass * parameters.gravity, pivot
    return np.array([parameters.hover_thrust, y * pole, -x * pole, 0.0])


def hover_thrusts(vehicle: Vehicle) -> Floats:
    """Return the rotor thrusts that hold body and upright pole at rest, N, shape (4,).

    They make no torque, unless the pivot is beside the centre of mass.
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
    low, high = rotors_of(vehicle).thrust
    hover = hover_thrusts(vehicle)
    room = np.minimum(hover - low, high - hover)  # N, of each rotor, in both senses
    per_torque = np.abs(np.linalg.inv(mixing(vehicle))[:, 1:])  # N per N·m
    with np.errstate(divide="ignore"):
        roll, pitch, yaw = (room[:, np.newaxis] / per_torque).min(axis=0).tolist()
    return min(roll, pitch), yaw


def rotors_of(vehicle: Vehicle) -> Rotors:
    """Return the rotors of a vehicle that has some."""
    if vehicle.rotors is None:
        raise ValueError(f"the vehicle {vehicle.name!r} has no rotors")
    return vehicle.rotors


def _check_inertia(vehicle: Vehicle) -> None:
    """Refuse an inertia that no rigid body has."""
    matrix = vehicle.inertia_matrix
    if np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
        raise ValueError(f"vehicle.inertia must be symmetric, not {vehicle.inertia!r}")
    least, middle, largest = np.linalg.eigvalsh(matrix).tolist()
    if least <= 0.0:
        raise ValueError(f"vehicle.inertia must be positive definite, not {vehicle.inertia!r}")
    if largest > (least + middle) * (1.0 + 1e-9):
        raise ValueError(
            "vehicle.inertia must have principal moments of which none exceeds the sum of the others, not"
            f" {least:g}, {middle:g} and {largest:g} kg·m²"
        )


def _check_euler(vehicle: Vehicle) -> None:
    """Refuse what the paper's attitude model does not have."""
    absent = {
        "rotors": vehicle.rotors is not None,
        "pivot": any(vehicle.pivot),
        "rate_loop": vehicle.rate_loop != RateLoop(),
        "pole.inertia": vehicle.pole.inertia > 0.0,
        "drag.rotor": any(vehicle.drag.rotor),
        "drag.angular": any(vehicle.drag.angular),
        "drag.height": vehicle.drag.height != 0.0,
        "inertia with products of inertia": isinstance(vehicle.inertia[0], tuple),
    }
    if given := [name for name, is_given in absent.items() if is_given]:
        raise ValueError(f"vehicle.attitude 'euler', the paper's model, has no {given[0]}; take 'rigid'")


def _check_rotors(vehicle: Vehicle, rotors: Rotors) -> None:
    """Refuse rotors that cannot hover or cannot make roll, pitch and yaw torques."""
    low, high = rotors.thrust
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
            f"rotors.thrust of {low:g} to {high:g} N must allow hover of body and pole, {vehicle.weight:g} N, with a"
            f" margin of {_MARGIN:.0%}, which needs {', '.join(f'{thrust:.3g}' for thrust in hover)} N"
        )
    lag = 0.5 * sum(rotors.lags)
    if vehicle.rate_loop.time_constant < FASTEST_LOOP * lag:
        raise ValueError(
            f"rate_loop.time_constant must be at least half the rotors' lag of {lag:g} s, not"
            f" {vehicle.rate_loop.time_constant:g} s"
        )


VEHICLES = {name: Vehicle(**{"name": name, **data}) for name, data in PRESETS["vehicles"].items()}


def as_vehicle(value: Any) -> Vehicle:
    """Return a vehicle from itself, a name in `VEHICLES`, the path of a .toml file, or a mapping of its fields.

    ``"random:17"`` is the vehicle of `family` with the seed 17. None is the paper's vehicle.
    """
    if value is None:
        return VEHICLES["paper"]
    if isinstance(value, Path) or (isinstance(value, str) and value.endswith(".toml")):
        path = Path(value)
        try:
            data = read_toml(path)
        except OSError as error:
            raise ValueError(f"the vehicle file {str(path)!r} cannot be read: {error.strerror}") from error
        try:
            return Vehicle(**{"name": path.stem, **data})
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    if isinstance(value, str):
        if re.fullmatch(_RANDOM, value):
            return Vehicle(**random_vehicle(int(value[7:])))
        return look_up(VEHICLES, value, "vehicle", "; or give a TOML file, or random:SEED")
    return parse(Vehicle, value, "vehicle")


# annotation of a field that holds a vehicle
VehicleField = Parsed(
    as_vehicle, lambda: Literal[tuple(VEHICLES)] | Annotated[str, Field(pattern=rf"\.toml$|{_RANDOM}")] | Vehicle
)
