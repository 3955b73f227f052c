"""Layout of the physical parameters in arrays, command limits and simulation settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, cast

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.ranges import Range, check_fields
from quadpend_gym.core.validation import from_plain, suggest
from quadpend_gym.vehicles import VEHICLES, Vehicle, as_vehicle, torque_limits
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
MOST_SUBSTEPS = 10_000
MOST_DELAYED = 1000  # control periods from an action to the moment when it acts
# Largest rate at which linear drag slows a motion, times the length of a substep. The drag of the rotors is constant
# during a substep, so it would reverse the motion above 1. Angular drag is part of the Runge-Kutta step, which is
# unstable above 2.8. The rest is for parameters that are drawn for each episode.
MOST_DAMPED = {"rotor": 0.5, "angular": 1.0}


@dataclass(frozen=True)
class Actuators:
    """Torque limits: the torques that an action of ±1 commands. `Simulation` derives the thrust limit from the weight.

    Raises:
        TypeError: If a value is not a number.
        ValueError: If a value is outside its range.
    """

    roll_pitch_torque: Annotated[float, Range(1e-9, 1e6, "N·m")] = 5.0  # by default τφ = 5 a₁ and τθ = 5 a₂
    yaw_torque: Annotated[float, Range(1e-9, 1e6, "N·m")] = 1.0  # by default τψ = a₃

    def __post_init__(self) -> None:
        check_fields(self)


INTERFACES = ("wrench", "rotors", "body_rates")


@dataclass(frozen=True)
class Simulation:
    """Vehicle, physical parameters, command limits, and step sizes of the simulation.

    With a vehicle, `parameters` and `actuators` that are not given are those of the vehicle. `dataclasses.replace`
    keeps both, so ``replace(simulation, vehicle=…)`` would have the numbers of the former vehicle: use `as_simulation`,
    or for a scenario `Scenario.with_vehicle`.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is out of range, the vehicle does not have the interface, the parameters are those of
            another vehicle of `VEHICLES`, or linear drag slows the vehicle within less than a substep.
    """

    parameters: Parameters = PAPER
    actuators: Actuators = field(default_factory=Actuators)
    period: Annotated[float, Range(1e-9, 10.0, "s")] = CONTROL_PERIOD  # control period
    substeps: Annotated[int, Range(1, MOST_SUBSTEPS)] = 2  # Runge–Kutta steps in a control period
    vehicle: Any = None  # as `as_vehicle` takes it; None: the paper's
    interface: str = "wrench"  # what an action commands: "wrench", "rotors" or "body_rates"
    # from an action to the moment when it acts; a whole number of substeps
    latency: Annotated[float, Range(0.0, 1.0, "s")] = 0.0

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "parameters", from_plain(Parameters, self.parameters, "parameters"))
        set_field(self, "actuators", from_plain(Actuators, self.actuators, "actuators"))
        check_fields(self)
        if self.vehicle is not None:
            vehicle = as_vehicle(self.vehicle)
            if self.parameters == PAPER:
                set_field(self, "parameters", vehicle.parameters)
            _check_own(self.parameters, vehicle)
            if self.actuators == Actuators():
                set_field(self, "actuators", Actuators(*torque_limits(vehicle)))
            set_field(self, "vehicle", None if vehicle == VEHICLES["paper"] else vehicle)
        self._check_interface()
        if self.is_rigid:
            _check_damping(self)
        if self.latency > MOST_DELAYED * self.period * (1.0 + 1e-9):
            raise ValueError(
                f"latency must be at most {MOST_DELAYED} control periods of {self.period:g} s, not {self.latency:g} s"
            )
        delayed = self.latency / self.period * self.substeps
        if abs(delayed - round(delayed)) > 1e-6:
            raise ValueError(
                f"latency must be a whole number of substeps of {self.period / self.substeps:g} s"
                f" (period / substeps), not {self.latency:g} s"
            )

    def _check_interface(self) -> None:
        if self.interface not in INTERFACES:
            raise ValueError(
                f"interface must be one of {', '.join(INTERFACES)}, not {self.interface!r}"
                f"{suggest(self.interface, INTERFACES)}"
            )
        if not self.is_rigid:
            if self.interface != "wrench":
                raise ValueError(
                    f"interface must be 'wrench', not {self.interface!r}: the paper's attitude model has no rotors and"
                    " no body rates; choose a rigid vehicle, for example vehicle='hummingbird'"
                )
            if self.latency > 0.0:
                raise ValueError(
                    f"latency must be 0 for the paper's attitude model, not {self.latency:g} s: use the actuator"
                    " action_delay, or a rigid vehicle"
                )
        elif self.interface == "rotors" and self.rigid_vehicle.rotors is None:
            raise ValueError(f"interface must not be 'rotors': the vehicle {self.vehicle.name!r} has no rotors")

    @property
    def is_rigid(self) -> bool:
        """Whether the vehicle is a rigid body; else it has the paper's attitude model."""
        return self.vehicle is not None and self.vehicle.attitude == "rigid"

    @property
    def rigid_vehicle(self) -> Vehicle:
        """The vehicle, which must be a rigid body."""
        assert self.vehicle is not None
        return cast(Vehicle, self.vehicle)

    @property
    def delayed_substeps(self) -> int:
        """The latency in substeps."""
        return round(self.latency / self.period * self.substeps)

    @property
    def command_scale(self) -> Floats:
        """Scales that convert an action a to a command, shape (4,).

        With the interfaces "wrench" and "body_rates" the thrust is scale₀ (1 + a₀) in N, and the torques in N·m or the
        body rates in rad/s are scaleᵢ aᵢ. scale₀ is the weight, so a zero action commands the hover thrust and no
        torques or rates. With "rotors" the scale is that of "wrench", which controllers use; see
        `quadpend_gym.physics.rotors` for the thrusts of the rotors.
        """
        a, hover = self.actuators, self.parameters.hover_thrust
        if self.interface == "body_rates":
            loop = self.rigid_vehicle.rate_loop
            return np.array([hover, loop.roll_pitch, loop.roll_pitch, loop.yaw])
        return np.array([hover, a.roll_pitch_torque, a.roll_pitch_torque, a.yaw_torque])


def _check_damping(simulation: Simulation) -> None:
    """Refuse a linear drag that is too strong for the length of a substep."""
    drag, p, period = simulation.rigid_vehicle.drag, simulation.parameters, simulation.period
    inertia = scaled_inertia(simulation.rigid_vehicle, p)
    rates = {
        "rotor": max(drag.rotor) / p.quadrotor_mass,
        "angular": float(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(drag.angular))).real.max()),
    }
    name = max(rates, key=lambda name: rates[name] / MOST_DAMPED[name])
    least = int(np.ceil(period * rates[name] / MOST_DAMPED[name] * (1.0 - 1e-9)))
    if simulation.substeps < least:
        limit = f"substeps must be at least {least}, not {simulation.substeps}"
        if least > MOST_SUBSTEPS:
            longest = period * MOST_SUBSTEPS / least
            unit = 10.0 ** (np.floor(np.log10(longest)) - 1.0)  # of the second digit, to round down
            limit = (
                f"period must be at most {np.floor(longest / unit) * unit:.2g} s with {MOST_SUBSTEPS} substeps, not"
                f" {period:g} s"
            )
        raise ValueError(
            f"{limit}: drag.{name} = {getattr(drag, name)!r} slows the vehicle within {1.0 / rates[name]:.2g} s, and a"
            f" substep may last at most {MOST_DAMPED[name]:g} times as long"
        )


def scaled_inertia(vehicle: Vehicle, parameters: Parameters) -> Floats:
    """Return the inertia of a rigid vehicle with the moments of inertia in `parameters`, kg·m², shape (3, 3)."""
    inertia = vehicle.inertia_matrix
    moments = [parameters.inertia_roll, parameters.inertia_pitch, parameters.inertia_yaw]
    factors = np.sqrt(np.array(moments) / np.diag(inertia))
    return np.asarray(inertia * np.outer(factors, factors))


def _check_own(parameters: Parameters, vehicle: Vehicle) -> None:
    """Refuse the parameters of another vehicle of `VEHICLES`, which `dataclasses.replace` would keep."""
    others = [name for name, other in VEHICLES.items() if other.parameters == parameters]
    if others and parameters != vehicle.parameters:
        raise ValueError(
            f"parameters must not be those of the vehicle {others[0]!r} if the vehicle is {vehicle.name!r}: to change"
            " the vehicle of a simulation, use quadpend_gym.physics.parameters.as_simulation(simulation, vehicle=…)"
        )


def as_simulation(value: Any, vehicle: Any = None, interface: str | None = None) -> Simulation:
    """Return a simulation.

    Args:
        value: A `Simulation`, a mapping of its fields, or None for the default one.
        vehicle: Its vehicle, as `as_vehicle` takes it; None: that of `value`.
        interface: What an action commands; None: as in `value`.

    Raises:
        TypeError: If an argument has the wrong type.
        ValueError: If a value is unknown or out of range.
    """
    given = {"vehicle": vehicle, "interface": interface}
    given = {name: item for name, item in given.items() if item is not None}
    if isinstance(value, Simulation):
        if vehicle is not None:  # the new vehicle's numbers replace those that are the former vehicle's
            former, default = Simulation(vehicle=value.vehicle), Simulation()
            for name in ("parameters", "actuators"):
                if getattr(value, name) == getattr(former, name):
                    given[name] = getattr(default, name)
        return replace(value, **given) if given else value
    if isinstance(value, Mapping):
        return from_plain(Simulation, {**value, **given}, "simulation")
    return from_plain(Simulation, given if value is None else value, "simulation")
