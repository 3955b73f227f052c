"""Random vehicles, for policies that fly every vehicle: ``random:17`` is the one with the seed 17.

Mass, pole length, lag and rate loop span those of the rigid presets; some presets have shorter arms, and less or more
thrust, than any of these. With log-uniform factors in brackets:

| quantity                         | value                                                                          |
|----------------------------------|--------------------------------------------------------------------------------|
| mass M                           | [27 g, 1.7 kg]                                                                 |
| arm a, from centre to rotor      | 0.17 m (M / 0.5 kg)^⅓ [0.7, 1.4], in the X layout (70 %) or the plus layout    |
| inertia about x and y            | M a² [0.15, 0.4], each [0.8, 1.2]; about z their sum times [0.8, 0.95]         |
| lag of the rotors                | [12, 80] ms                                                                    |
| time constant of the rate loop   | the lag, at least 20 ms, times [1, 1.4]                                        |
| rates at an action of ±1         | [5, 12] rad/s about x and y, [2, 4] rad/s about z                              |
| highest thrust                   | weight [2, 6]                                                                  |
| pole, a uniform rod of 10 mm     | mass M [0.04, 0.12], length [0.3 m or 9 m/s · time constant, 1.5 m]            |
| pivot                            | 0.3 a above the centre                                                         |
| yaw torque per thrust            | 0.1 a [0.5, 1.5]                                                               |
| drag of the rotors; of the body  | 0.4 1/s M along each axis; an area of 0.3 a²                                   |
| lowest thrust of a rotor         | 0.02 M g                                                                       |
"""

from typing import Any

import numpy as np


def random_vehicle(seed: int) -> dict[str, Any]:
    """Return the fields of the `Vehicle` with this seed."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    mass = between(0.027, 1.7)
    arm = 0.17 * (mass / 0.5) ** (1 / 3) * between(0.7, 1.4)
    angles = np.radians(np.arange(0.0, 360.0, 90.0) + 45.0 * (random.random() < 0.7))
    inertia = mass * arm**2 * between(0.15, 0.4)
    roll, pitch = inertia * between(0.8, 1.2), inertia * between(0.8, 1.2)
    lag = between(0.012, 0.08)
    time_constant = max(lag, 0.02) * between(1.0, 1.4)
    pole_mass, extent = mass * between(0.04, 0.12), between(max(0.3, 9.0 * time_constant), 1.5)
    highest = 0.25 * 9.81 * (mass + pole_mass) * between(2.0, 6.0)
    return {
        "name": f"random:{seed}",
        "mass": mass,
        "inertia": (roll, pitch, (roll + pitch) * between(0.8, 0.95)),
        "pole": {
            "mass": pole_mass,
            "length": 0.5 * extent,
            "inertia": pole_mass * extent**2 / 12.0,
            "drag_area": 0.01 * extent,  # a diameter of 10 mm
        },
        "pivot": (0.0, 0.0, 0.3 * arm),
        "rotors": {
            "positions": tuple(zip((arm * np.cos(angles)).tolist(), (arm * np.sin(angles)).tolist(), strict=True)),
            "spins": (1, -1, 1, -1),
            "thrust": (0.02 * mass * 9.81, highest),
            "torque_per_thrust": 0.1 * arm * between(0.5, 1.5),
            "lag_up": lag,
        },
        "drag": {"area": 0.3 * arm**2, "rotor": (0.4 * mass, 0.4 * mass, 0.4 * mass)},
        "rate_loop": {"time_constant": time_constant, "roll_pitch": between(5.0, 12.0), "yaw": between(2.0, 4.0)},
    }
