"""Public flights as the yardstick of `identify`: the multi-step test of NanoDrone, and held-out flights of NanoBench.

    python -m experiments.public_flights nanodrone DATA        # data/real/raw/parquets of its branch model_export
    python -m experiments.public_flights nanobench DATA        # datasets/dataset

NanoDrone, github.com/idsia-robotics/nanodrone-sysid-benchmark: Crazyflie 2.1 Brushless, measured speeds of the rotors.
Its test predicts position, velocity, attitude and body rate 1 to 50 steps of 10 ms ahead, from every sample of the
melon flights, and takes the mean of the errors' norms; models train on square, random and chirp flights
(dataset/dataset.py and utils/metrics_utils.py of its branch main). Its tables are low-passed forward and backward
(processing/csv_to_processed of its branch dev). Copies without LFS have raw tables alone: `processed` repeats this. Its
chirp is the raw multisine, and its random is random2: the means of the motors in scalers/lstm_random are those of it.

NanoBench, github.com/syediu/nanobench-iros2026: Crazyflie 2.1, commands of the motors and voltage of the battery.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.files import read_toml
from quadpend_gym.vehicles import Vehicle, rotors_of
from quadpend_gym.vehicles.vehicle import as_vehicle
from quadpend_train.flight_logs.identify import Found, identify
from quadpend_train.flight_logs.log import Columns, FlightLog, make_log
from quadpend_train.flight_logs.readers import read_log
from quadpend_train.flight_logs.replay import Thrust, Windows, compare, errors, fly, held

TABLES = Path(__file__).with_name("columns")
KINDS = ("multisine", "random2", "square")
STEPS = (1, 10, 50)
AT = 0.25  # s, of the comparison of NanoBench
FITTED = ("B2_circle_fast_rep2", "B8_star_fast_rep2")
TESTED = ("B3_figure8_fast_rep2", "B5_helix_fast_rep2", "B7_oval_fast_rep2")
CUTOFFS = {"position": 10.0, "attitude": 12.0, "velocity": 18.0, "motors": 20.0}  # Hz
PUBLISHED = {  # results/model_comparison.ipynb of the branch main
    "constant": "0.0143 0.1430 0.6797 0.0329 0.3182 1.4749 0.0071 0.0692 0.3041 0.0796 0.3596 0.8837",
    "physics": "0.0013 0.0126 0.1269 0.0080 0.0570 0.5781 0.0011 0.0205 0.2544 0.0796 0.3596 0.8837",
    "MLP": "0.0032 0.0305 0.1712 0.0116 0.0890 0.5720 0.0022 0.0331 0.2268 0.1138 0.5949 0.9005",
    "hybrid": "0.0016 0.0166 0.1119 0.0092 0.0613 0.5556 0.0027 0.0376 0.2306 0.0912 0.4880 0.5979",
    "LSTM": "0.0079 0.0390 0.2572 0.0247 0.1175 0.7407 0.0066 0.0372 0.2325 0.1021 0.4292 1.2407",
}
CHANNELS = ("position, m", "velocity, m/s", "attitude, rad", "rate, rad/s")


def processed(path: Path, columns: Columns) -> FlightLog:
    """Return a raw flight of NanoDrone as its authors process it, from the third second on, for 65 s at most."""
    raw = pd.read_parquet(path).bfill().ffill()
    motors = raw[list(columns.motors)].mask(raw[list(columns.motors)] > 3e5)  # as the authors: no such speed
    table = pd.DataFrame({"t": raw.t})

    def add(names: Any, values: Any, kind: str) -> None:
        sections = butter(4, CUTOFFS[kind], fs=100.0, output="sos")
        table[list(names)] = sosfiltfilt(sections, np.asarray(values, float), axis=0)

    add("xyz", raw[["x", "y", "z"]], "position")
    speeds = ["vx", "vy", "vz", "wx", "wy", "wz"]
    add(speeds, raw[speeds], "velocity")
    add(columns.motors, motors.bfill().ffill(), "motors")
    turns = ["rx", "ry", "rz"]
    add(turns, Rotation.from_quat(raw[["qx", "qy", "qz", "qw"]]).as_rotvec(), "attitude")
    table[["qx", "qy", "qz", "qw"]] = Rotation.from_rotvec(table[turns]).as_quat()
    return make_log(path.stem, table[200 : 6700 if len(table) > 6700 else -200], columns)


def multistep(log: FlightLog, motion: Any, windows: Windows) -> Floats:
    """Return the norms of the errors after `STEPS`, shape (3, w, 4)."""
    found = errors(motion, windows)[list(STEPS)]
    return np.asarray(np.linalg.norm(found.reshape(*found.shape[:2], 4, 3), axis=-1))


def nanodrone(data: Path, start: Vehicle) -> pd.DataFrame:
    """Return the table of the multi-step test: rows are models, columns channels and steps.

    Args:
        data: Folder of the raw flights.
        start: Vehicle with which the fit begins.
    """
    columns = Columns(**read_toml(TABLES / "nanodrone.toml"))
    training = [data / f"{kind}_20251017_run{run}.parquet" for kind in KINDS for run in (1, 2, 3)]
    found = identify([processed(path, columns) for path in training], start, training=1.0)
    print(found.table())
    tests = [
        processed(data / f"melon_20251017_run{run}.parquet", columns) for run in (1, 4, 5)
    ]  # the second one is broken
    models: dict[str, list[Floats]] = {"constant, here": [], f"{start.name}, here": [], "identified, here": []}
    for log in tests:
        windows = Windows(log, np.arange(len(log) - STEPS[-1]), STEPS[-1])
        still = np.tile(held(windows)[:1], (STEPS[-1] + 1, 1, 1))
        known = Thrust(rotors_of(start).thrust_coefficient or found.thrust.coefficient)
        flown = still, fly(windows, start, known), fly(windows, found.vehicle, found.thrust, found.delay)
        for name, motion in zip(models, flown, strict=True):
            models[name].append(multistep(log, motion, windows))
    rows = {name: [float(x) for x in text.split()] for name, text in PUBLISHED.items()}
    rows |= {name: np.concatenate(each, axis=1).mean(axis=1).T.ravel().tolist() for name, each in models.items()}
    return pd.DataFrame.from_dict(rows, "index", columns=pd.MultiIndex.from_product([CHANNELS, STEPS]))


def nanobench(data: Path, start: Vehicle) -> tuple[Found, pd.DataFrame]:
    """Return the vehicle fitted to `FITTED`, and its errors on `TESTED` after `AT` as shares of others."""
    fitted, tested = (
        [read_log(data / f"{name}.csv", TABLES / "nanobench.toml") for name in each] for each in (FITTED, TESTED)
    )
    found, rows = identify(fitted, start, tests=tested), list[dict[str, Any]]()
    for raw, log in zip(tested, found.held_out, strict=True):
        vehicles = {start.name: start, "identified": found.vehicle}
        ours = compare(log, vehicles, delay=found.delay, thrusts={"identified": found.thrust})
        theirs, row = compare(raw, vehicles)[start.name], {"flight": log.name}
        for channel in ("position", "attitude"):
            at = round(AT / log.period)
            own = ours["identified"][channel][at]
            row |= {channel: own, f"{channel}/held": own / ours["held"][channel][at]}
            row |= {f"{channel}/preset": own / theirs[channel][at]}
            row |= {f"{channel}/preset with the trim": own / ours[start.name][channel][at]}
        rows.append(row)
    return found, pd.DataFrame(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", choices=("nanodrone", "nanobench"))
    parser.add_argument("data", type=Path, help="folder of the flights")
    given = parser.parse_args()
    if given.set == "nanodrone":
        table = nanodrone(given.data, as_vehicle("crazyflie-brushless"))
        print(table.to_string(float_format="{:.4f}".format))
    else:
        vehicle, table = nanobench(given.data, as_vehicle("crazyflie"))
        print(vehicle.table())
        print(table.to_string(float_format="{:.3f}".format))
