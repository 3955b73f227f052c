"""Doubts about a vehicle: numbers that are possible, but probably wrong or hardly flyable."""

import numpy as np

from quadpend_gym.vehicles.simulation import Simulation

__all__ = ["delays", "doubts"]

_REACH = 1.5  # arms: the farthest pivot
LATE = 0.5  # times in which the pole falls: the longest delay
LEAST_THRUST = 1.3  # weights
_CENTRED, _TOLERANCE = 1.0 / 12.0, 0.02  # J/(m L²) of a tube of the full length L about its centre


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
    if rotors is None:
        return out
    arm = float(np.linalg.norm(np.array(rotors.positions)[:, :2], axis=1).max())
    if rotors.torque_per_thrust > arm:
        out.append(f"rotors.torque_per_thrust of {rotors.torque_per_thrust:g} m exceeds the arm of {arm:.3g} m")
    if (distance := float(np.linalg.norm(vehicle.pivot))) > _REACH * arm:
        out.append(f"the pivot is {distance:.3g} m from the centre of mass, beyond the frame with arms of {arm:.3g} m")
    if (most := 4.0 * rotors.thrust[1]) < LEAST_THRUST * vehicle.weight:
        out.append(f"the rotors make {most / vehicle.weight:.2f} times the weight at most: little is left for control")
    return out
