"""Gains for a nominal vehicle: those of `gains` for the paper's vehicle, scaled to the time constants of another one.

Near hover, all vehicles have the same equations in units of their own time, length, force and torque:

    rate   √K = √((M + m) g/(M' λ)), at which an upright pole falls       `Parameters.chain_stiffness` of the equivalent
    length g/K, torque I K, force: the weight                             pendulum, see `modelling.equivalent`

A gain in such units is the same number for all vehicles. `EXPONENTS` has the power of √K by which each gain is
multiplied; gains that are not listed, such as damping ratios, angles and the noise of the sensors, do not change.
"""

from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from quadpend_baselines.gains import (
    GAINS,
    HANGING_GAINS,
    HUMMINGBIRD_GAINS,
    RIGID_GAINS,
    UNPREDICTED,
    AdrcGains,
    DualModeGains,
    EstimatorGains,
    FlatnessGains,
    LqgGains,
    LqrGains,
    NmpcGains,
    ObserverGains,
    SwingUpGains,
)
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.nested import changed
from quadpend_gym.physics.plants import RigidPlant, plant_of
from quadpend_gym.vehicles import VEHICLES, as_vehicle

EXPONENTS: dict[type, dict[str, float]] = {
    ObserverGains: {"bandwidth": 1},
    AdrcGains: {"horizontal_bandwidth": 1, "vertical_bandwidth": 1, "horizontal.switching": 6, "vertical.switching": 2},
    FlatnessGains: {
        "position_bandwidth": 1,
        "pendulum_bandwidth": 1,
        "attitude_bandwidth": 1,
        "vertical_bandwidth": 1,
        "velocity": -1,
        "far_pendulum_bandwidth": 1,
        "far_attitude_bandwidth": 1,
    },
    LqrGains: {"position": -2, "velocity": -1, "angle_rate": 1, "reach": -2, "integral": -3, "integral_limit": -3},
    DualModeGains: {"near_error": -2.5, "far_error": -2.5},
    LqgGains: {"effort": -2, "yaw": -2, "near_error": -2.5, "far_error": -2.5},
    NmpcGains: {"period": -1},
    SwingUpGains: {
        "damp": -1,
        "lead": -1,
        "position": 2,
        "velocity": 1,
        "attitude_bandwidth": 1,
        "vertical_bandwidth": 1,
    },
}


def scale_gains(gains: Any, tuned: Parameters, other: Parameters) -> Any:
    """Return the gains for a vehicle from those that were tuned for another, by the design parameters of both."""
    rate = float(np.sqrt(abs(other.chain_stiffness) / tuned.chain_stiffness))
    factors = {path: rate**exponent for path, exponent in EXPONENTS.get(type(gains), {}).items()}
    if isinstance(gains, EstimatorGains):
        factors["force_walk"] = rate**0.5 * other.hover_thrust / tuned.hover_thrust
        factors["bob_force_walk"] = factors["gust_walk"] = rate**0.5 * other.bob_mass / tuned.bob_mass
        factors["torque_walk"] = rate**2.5 * other.inertia_roll / tuned.inertia_roll
        factors["torque_noise"] = rate**1.5 * other.inertia_roll / tuned.inertia_roll
    present = {path: attrgetter(path)(gains) for path in factors}
    gains = changed(gains, {path: factors[path] * gain for path, gain in present.items() if gain is not None})
    parts = {field.name: getattr(gains, field.name) for field in fields(gains)}
    return replace(
        gains, **{name: scale_gains(part, tuned, other) for name, part in parts.items() if is_dataclass(part)}
    )


@lru_cache(maxsize=256)
def gains_for(name: str, simulation: Simulation) -> Any:
    """Return the gains of a controller, a key of `DESCRIPTIONS`, for a nominal simulation.

    Simulations without a rigid vehicle have the gains `GAINS`, and those with a negative rod length, see
    `controllers.controller`, have `HANGING_GAINS`. The hummingbird has `HUMMINGBIRD_GAINS`. Others have `RIGID_GAINS`,
    scaled from the vehicle for which these were tuned.
    """
    if name.endswith(UNPREDICTED):
        gains = gains_for(name.removesuffix(UNPREDICTED), simulation)
        return replace(gains, estimator=replace(gains.estimator, predicts=False))
    if simulation.parameters.rod_length < 0.0:
        return HANGING_GAINS.get(name, GAINS[name])
    if not isinstance(plant_of(simulation), RigidPlant):
        return GAINS[name]
    if name in HUMMINGBIRD_GAINS and simulation.vehicle == VEHICLES["hummingbird"]:
        return HUMMINGBIRD_GAINS[name]
    gains, vehicle = RIGID_GAINS.get(name, (GAINS[name], None))
    tuned_for = equivalent_model(Simulation(as_vehicle(vehicle)))
    return scale_gains(gains, tuned_for.parameters, equivalent_model(simulation).parameters)
