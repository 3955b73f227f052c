"""Identification of simulated vehicles.

    python -m experiments.identification                    # 20 simulated vehicles: docs/identification/simulated.csv
    python -m experiments.identification --poles --vehicles 10       # with poles, upright and hanging: poles.csv

Vehicles and poles are random; a fit begins with the true mass and geometry.
"""

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.pages import DOCS
from experiments.simulated_logs import simulated_log
from quadpend_gym.vehicles import VEHICLES, Vehicle, rotors_of
from quadpend_train.flight_logs.identify import QUANTITIES, identify, stretched

PATH, POLES = DOCS / "identification/simulated.csv", DOCS / "identification/poles.csv"
FLIGHTS = {"upright": (1.0,), "hanging": (-1.0,), "none, upright": (0.0, 1.0), "none, hanging": (0.0, -1.0)}
BASES = ("hummingbird", "crazyflie-brushless", "racer", "x500")
LISTED = ("thrust_coefficient", "torque_per_thrust", "inertia_roll", "inertia_pitch", "drag_x", "drag_y", "drag_z")


def random_vehicle(seed: int) -> tuple[Vehicle, Vehicle, dict[str, float]]:
    """Return a vehicle, the start of its identification with the true mass and geometry, and the true quantities."""
    random = np.random.default_rng(seed)
    base = VEHICLES[BASES[seed % len(BASES)]]
    rotors, mass = rotors_of(base), base.mass

    def factor(spread: float) -> float:
        return float(np.exp(spread * random.uniform(-1.0, 1.0)))

    positions = np.array(rotors.positions)
    arm, coefficient = float(np.abs(positions).max()), rotors.thrust_coefficient or 5e-6 * mass
    roll, pitch, yaw = np.diag(base.inertia_matrix).tolist()
    centre = np.append(0.03 * arm * random.uniform(-1.0, 1.0, 2), 0.0)
    moved: Any = tuple(map(tuple, positions - centre))
    inertia = roll * factor(0.3), pitch * factor(0.3)
    drag = 0.4 * mass * factor(0.5), 0.4 * mass * factor(0.5), 0.4 * mass * factor(0.5)
    slow = replace(base.rate_loop, time_constant=0.1)
    start = replace(base, rotors=replace(rotors, thrust_coefficient=coefficient), rate_loop=slow)
    truth = {
        "thrust_coefficient": coefficient * factor(0.3),
        "torque_per_thrust": rotors.torque_per_thrust * factor(0.3),
        "yaw_trim": 0.0,
        "rotor_inertia": 0.002 * roll * factor(0.5),
        "inertia_roll": inertia[0],
        "inertia_pitch": inertia[1],
        "lag": 0.03 * factor(0.5),
        "delay": 0.0125,  # of the log, and half a period of the controller that holds its command
        **dict(zip(("drag_x", "drag_y", "drag_z"), drag, strict=True)),
        "drag_height": 0.3 * arm * random.uniform(-1.0, 1.0),
        "angular_drag": inertia[0] * factor(0.7),
        "angular_drag_yaw": inertia[0] * factor(0.7),
        "centre_x": float(centre[0]),
        "centre_y": float(centre[1]),
    }
    vehicle = replace(
        start,
        inertia=(*inertia, sum(inertia) * yaw / (roll + pitch)),
        rotors=replace(
            rotors,
            positions=moved,
            thrust=(0.02 * rotors.thrust[1], 1.3 * rotors.thrust[1]),
            torque_per_thrust=truth["torque_per_thrust"],
            lag_up=truth["lag"],
            lag_down=None,
            inertia=truth["rotor_inertia"],
            thrust_coefficient=truth["thrust_coefficient"],
        ),
        drag=replace(
            base.drag,
            area=0.0,
            rotor=drag,
            height=truth["drag_height"],
            angular=(truth["angular_drag"], truth["angular_drag"], truth["angular_drag_yaw"]),
        ),
    )
    return vehicle, start, truth


def random_pole(vehicle: Vehicle, seed: int) -> tuple[Vehicle, dict[str, float]]:
    """Return the vehicle with a random pole of the same mass, and the true quantities of the pole."""
    length, drag = np.exp([0.3, 0.5] * np.random.default_rng((seed, 1)).uniform(-1.0, 1.0, 2)).tolist()
    pole = stretched(vehicle.pole, length * vehicle.pole.length, drag * vehicle.pole.drag_area)
    return replace(vehicle, pole=pole), {"pole_length": pole.length, "pole_drag_area": pole.drag_area}


def simulated(vehicles: int, sides: tuple[float, ...] = (0.0,)) -> pd.DataFrame:
    """Return one row for each quantity of each vehicle, with one flight for each side of `simulated_log`."""
    rows = list[dict[str, Any]]()
    for seed in range(vehicles):
        vehicle, start, truth = random_vehicle(seed)
        if any(sides):
            vehicle, pole = random_pole(vehicle, seed)
            truth |= pole
        found = identify([simulated_log(vehicle, seed + 1000 * i, side=side) for i, side in enumerate(sides)], start)
        for name, estimate in found.estimates.items():
            low, high = estimate.interval
            row = {
                "vehicle": seed,
                "base": vehicle.name,
                "quantity": name,
                "true": truth[name],
                "value": estimate.value,
            }
            rows.append(row | {"low": low, "high": high, "identified": estimate.identified})
        print(pd.DataFrame(rows[-len(truth) :]).to_string(), flush=True)
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return for each quantity how often it is identified, the median and largest error, and the coverage."""
    known = table[table.identified]
    error = (known.value / known.true.mask(known.true == 0.0) - 1.0).abs()
    covered = (known.low <= known.true) & (known.true <= known.high)
    groups = known.quantity
    parts = {
        "identified": table.groupby("quantity").identified.mean(),
        "median error": error.groupby(groups).median(),
        "largest error": error.groupby(groups).max(),
        "coverage": covered.groupby(groups).mean(),
    }
    listed = known.quantity.isin(LISTED)
    print(f"coverage of all identified: {covered.mean():.1%}; listed within 5 %: {(error[listed] < 0.05).mean():.1%}")
    return pd.DataFrame(parts).reindex([name for name in QUANTITIES if name in set(table.quantity)])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=20, help="number of simulated vehicles")
    parser.add_argument("--poles", action="store_true", help="fly with poles")
    given = parser.parse_args()
    if given.poles:
        tables = {name: simulated(given.vehicles, sides=sides) for name, sides in FLIGHTS.items()}
        pd.concat(tables, names=["flights"]).droplevel(1).to_csv(POLES, float_format="%.6g")
        for name, table in tables.items():
            print(name)
            print(summary(table).to_string(float_format="{:.4f}".format))
    else:
        table = simulated(given.vehicles)
        PATH.parent.mkdir(exist_ok=True)
        table.to_csv(PATH, index=False, float_format="%.6g")
        print(summary(table).to_string(float_format="{:.3f}".format))
