"""Doubts about a vehicle: numbers that are possible, but probably wrong or hardly flyable."""

import numpy as np

from quadpend_gym.vehicles.parts import Rotors
from quadpend_gym.vehicles.simulation import Simulation
from quadpend_gym.vehicles.vehicle import Vehicle

__all__ = ["delays", "doubts"]

LATE = 0.5  # times in which the pole falls: the longest delay
LEAST_THRUST = 1.3  # weights
MOST_THRUST = 8.0  # weights; four times as much as most have: the thrust of all rotors given as that of one
_CENTRED, _TOLERANCE = 1.0 / 12.0, 0.02  # J/(m L²) of a tube of the full length L about its centre
_POINT, _LONG = 0.1, 1.5  # J/(m l²) of what is no tube, and extent/l of what is no bob at the end of a thread


def delays(simulation: Simulation) -> dict[str, float]:
    """Return what passes until a command acts, s."""
    vehicle, late = simulation.vehicle, {"the latency": simulation.latency}
    if simulation.interface == "body_rates":
        late["the rate loop"] = vehicle.rate_loop.time_constant
    elif vehicle.rotors is not None:
        late["the rotors' lag"] = 0.5 * sum(vehicle.rotors.lags)
    return late


def doubts(simulation: Simulation) -> list[str]:
    """Return one sentence, without its full stop, about each implausible property of a vehicle and its delays."""
    vehicle, rotors, pole = simulation.vehicle, simulation.vehicle.rotors, simulation.vehicle.pole
    fall, out = vehicle.stiffness**-0.5, []
    late = delays(simulation)
    if (total := sum(late.values())) > LATE * fall:
        parts = " and ".join(f"{value:.3g} s of {name}" for name, value in late.items() if value)
        out.append(
            f"{total:.3g} s pass until a command acts ({parts}), but the pole falls in {fall:.3g} s (1/√K): more than"
            f" {LATE:g} times this is hardly flyable"
        )
    if abs(pole.inertia / (pole.mass * pole.length**2) / _CENTRED - 1.0) < _TOLERANCE:
        out.append(
            "pole.length seems to be the full length of a tube; it must be the distance from the pivot to the centre of"
            " mass"
        )
    elif pole.inertia < _POINT * pole.mass * pole.length**2 and pole.full_length > _LONG * pole.length:
        tube = pole.mass * pole.full_length**2 / 12.0
        out.append(
            f"pole.inertia of {pole.inertia:g} kg·m² is that of a small body; a tube of its extent has {tube:.3g}"
        )
    if rotors is None:
        return out
    unusual = {name: each for name, each in _ratios(vehicle, rotors).items() if each[0]}  # zero: not modelled
    return out + [
        f"{name} is {value:.3g}, of most quadrotors {low:g} to {high:g}: check the numbers and their units"
        for name, (value, low, high) in unusual.items()
        if not low <= value <= high
    ]


def _ratios(vehicle: Vehicle, rotors: Rotors) -> dict[str, tuple[float, float, float]]:
    """Return numbers of a vehicle by what they are, with the range in which those of most quadrotors are.

    A factor of ten leaves the range, for most vehicles and numbers.
    """
    pole, drag, loop, mass = vehicle.pole, vehicle.drag, vehicle.rate_loop, vehicle.mass
    arm = float(np.linalg.norm(np.array(rotors.positions)[:, :2], axis=1).max())
    roll, pitch, yaw = np.diag(vehicle.inertia_matrix).tolist()
    speed = (0.25 * vehicle.weight / rotors.thrust_coefficient) ** 0.5 if rotors.thrust_coefficient else 0.0
    return {
        "inertia about x over mass arm²": (roll / (mass * arm**2), 0.06, 1.2),
        "inertia about y over mass arm²": (pitch / (mass * arm**2), 0.06, 1.2),
        "inertia about z over the sum of both others": (yaw / (roll + pitch), 0.5, 1.01),
        "pivot over arm": (float(np.linalg.norm(vehicle.pivot)) / arm, 0.0, 1.5),
        "pole.mass over mass": (pole.mass / mass, 0.015, 0.35),
        "pole.length over arm": (pole.length / arm, 0.4, 25.0),
        "pole.drag_area over extent (m)": (pole.drag_area / pole.full_length, 0.001, 0.03),
        "rotors.thrust of all four over the weight": (
            4.0 * rotors.thrust[1] / vehicle.weight,
            LEAST_THRUST,
            MOST_THRUST,
        ),
        "rotors.torque_per_thrust over arm": (rotors.torque_per_thrust / arm, 0.02, 0.45),
        "rotors.lag_up (s)": (rotors.lag_up, 0.004, 0.12),
        "speed of the rotors in hover times arm (m/s)": (speed * arm, 30.0, 250.0),
        "drag.area over arm²": (drag.area / arm**2, 0.05, 3.0),
        **{
            f"drag.rotor along {axis} over mass (1/s)": (each / mass, 0.08, 2.0)
            for axis, each in zip("xyz", drag.rotor, strict=True)
        },
        "rate_loop.roll_pitch (rad/s)": (loop.roll_pitch, 1.5, 40.0),
        "rate_loop.yaw (rad/s)": (loop.yaw, 0.5, 15.0),
    }
