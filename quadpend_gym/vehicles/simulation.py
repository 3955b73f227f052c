"""The simulation of a vehicle: its command interface, control period, step size and latency."""

from dataclasses import field
from functools import cached_property
from typing import Annotated, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.vehicles.parameters import Parameters
from quadpend_gym.vehicles.vehicle import VEHICLES, Vehicle, VehicleField, torque_limits

__all__ = ["CONTROL_PERIOD", "Simulation"]

CONTROL_PERIOD = 0.01  # s: the control loop runs at 100 Hz
Interface = Literal["wrench", "rotors", "body_rates"]
_MOST_DELAYED = 1000  # control periods from an action to the moment when it acts
# Largest rate at which linear drag slows a motion, times the length of a substep. The drag of the rotors is constant
# during a substep, so it would reverse the motion above 1. Angular drag is part of the Runge-Kutta step, which is
# unstable above 2.8. The rest is for parameters that are drawn for each episode.
_MOST_DAMPED = {"rotor": 0.5, "angular": 1.0}


@settings
class Simulation:
    """A vehicle, what an action commands, and when and how exactly the simulation computes its motion."""

    vehicle: Annotated[Vehicle, VehicleField] = field(default_factory=lambda: VEHICLES["paper"])
    interface: Interface = "wrench"  # what an action commands
    # control period, the time from one action to the next
    period: Annotated[float, Range(1e-9, 10.0, "s")] = CONTROL_PERIOD
    substeps: Annotated[int, Range(1, 10_000)] = 2  # Runge–Kutta steps in a control period
    latency: Annotated[float, Range(0.0, 1.0, "s")] = 0.0  # time until an action acts; a whole number of substeps
    pendulum: Literal["upright", "hanging"] = "upright"  # control laws use "hanging", environments only "upright"

    def __post_init__(self) -> None:
        if self.vehicle.attitude == "euler" and self.interface != "wrench":
            raise ValueError(
                f"interface must be 'wrench' with the paper's attitude model, not {self.interface!r}; choose a rigid"
                " vehicle, for example vehicle='hummingbird'"
            )
        if self.interface == "rotors" and self.vehicle.rotors is None:
            raise ValueError(f"interface must not be 'rotors': the vehicle {self.vehicle.name!r} has no rotors")
        self._check_damping()
        if self.latency > _MOST_DELAYED * self.period * (1.0 + 1e-9):
            raise ValueError(
                f"latency must be at most {_MOST_DELAYED} control periods of {self.period:g} s, not {self.latency:g} s"
            )
        delayed = self.latency / self.period * self.substeps
        if abs(delayed - round(delayed)) > 1e-6:
            raise ValueError(
                f"latency must be a whole number of substeps of {self.period / self.substeps:g} s"
                f" (period / substeps), not {self.latency:g} s"
            )

    @cached_property
    def parameters(self) -> Parameters:
        """The physical parameters of the vehicle; with a hanging pendulum, the rod length is negative."""
        found = self.vehicle.parameters
        return found if self.pendulum == "upright" else found._replace(rod_length=-found.rod_length)

    @cached_property
    def torque_limits(self) -> tuple[float, float]:
        """Torques at an action of ±1 of the interface "wrench": (roll and pitch, yaw), N·m."""
        return torque_limits(self.vehicle)

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
        loop, (roll_pitch, yaw) = self.vehicle.rate_loop, self.torque_limits
        if self.interface == "body_rates":
            roll_pitch, yaw = loop.roll_pitch, loop.yaw
        return np.array([self.parameters.hover_thrust, roll_pitch, roll_pitch, yaw])

    def _check_damping(self) -> None:
        """Refuse a linear drag that is too strong for the length of a substep."""
        vehicle, period = self.vehicle, self.period
        drag, turning = vehicle.drag, np.linalg.solve(vehicle.inertia_matrix, np.diag(vehicle.drag.angular))
        rates = {"rotor": max(drag.rotor) / vehicle.mass, "angular": float(np.linalg.eigvals(turning).real.max())}
        name = max(rates, key=lambda name: rates[name] / _MOST_DAMPED[name])
        least = int(np.ceil(period * rates[name] / _MOST_DAMPED[name] * (1.0 - 1e-9)))
        if self.substeps < least:
            raise ValueError(
                f"substeps must be at least {least}, not {self.substeps}: drag.{name} = {getattr(drag, name)!r} slows"
                f" the vehicle in {1.0 / rates[name]:.2g} s, and a substep may last {_MOST_DAMPED[name]:g} times as"
                " long"
            )
