"""Readers of flight logs: CSV, PX4 (.ulg) by pyulog, and Betaflight blackbox (.bbl, .bfl) by orangebox."""

import logging
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quadpend_gym.core.files import read_toml
from quadpend_train.common.text import brief
from quadpend_train.flight_logs.log import DEFAULT, Columns, FlightLog, flights, make_log

# Motors in the order front left, back left, back right, front right of the presets in X layout.
PX4 = Columns(
    velocity=("vx", "vy", "vz"),
    rate=("wx", "wy", "wz"),
    motors=("motor3", "motor2", "motor4", "motor1"),
    time_unit="us",
    motor_unit="1",
    frame="down",
)
BETAFLIGHT = Columns(
    position=None,
    quaternion=None,
    rate=("gyroADC[0]", "gyroADC[1]", "gyroADC[2]"),
    rate_unit="deg/s",
    motors=("eRPM[3]", "eRPM[2]", "eRPM[0]", "eRPM[1]"),
    time_unit="us",
    motor_unit="100 rpm",
    measured=True,
    poles=7,
    frame="up",
)
THROTTLES = replace(  # of Betaflight without bidirectional DShot
    BETAFLIGHT,
    motors=("throttle[3]", "throttle[2]", "throttle[0]", "throttle[1]"),
    motor_unit="1",
    measured=False,
    poles=1,
)
_DSHOT, _PULSES = (48.0, 2047.0), (1000.0, 2000.0)  # commands of a motor at rest and at full throttle
_TOPICS = {  # of PX4: fields and the names of their columns
    "vehicle_local_position": {name: name for name in ("x", "y", "z", "vx", "vy", "vz")},
    "vehicle_attitude": {f"q[{i}]": f"q{axis}" for i, axis in enumerate("wxyz")},
    "vehicle_angular_velocity": {f"xyz[{i}]": f"w{axis}" for i, axis in enumerate("xyz")},
    "actuator_motors": {f"control[{i}]": f"motor{i + 1}" for i in range(4)},
}


def as_columns(columns: Columns | str | Path | None, default: Columns) -> Columns:
    """Return columns from themselves or the TOML file of their fields; None is the default.

    Those of a file replace some of a format's own. For a CSV file, they are all that there is.
    """
    if not isinstance(columns, str | Path):
        return columns or default
    given = read_toml(Path(columns))
    return Columns(**given) if default is DEFAULT else replace(default, **given)


def read_log(path: str | Path, columns: Columns | str | Path | None = None) -> FlightLog:
    """Read the log of one flight, see `read_logs`."""
    logs = read_logs(path, columns)
    if len(logs) > 1:
        raise ValueError(f"the log {str(path)!r} has {len(logs)} flights; take read_logs")
    return logs[0]


def read_logs(path: str | Path, columns: Columns | str | Path | None = None) -> list[FlightLog]:
    """Read the flights of a file.

    Args:
        path: CSV file, PX4 log (.ulg) or Betaflight log (.bbl, .bfl).
        columns: `Columns` or the TOML file of its fields, which replace those of a format.
    """
    path = Path(path)
    read, default, kind = {
        ".ulg": (_px4, PX4, "a PX4 log (ULog)"),
        ".bbl": (_betaflight, BETAFLIGHT, "a Betaflight log, which begins with 'H Product:Blackbox'"),
        ".bfl": (_betaflight, BETAFLIGHT, "a Betaflight log, which begins with 'H Product:Blackbox'"),
    }.get(path.suffix.lower(), (read_csv, DEFAULT, "a line of names and rows of as many numbers (CSV, UTF-8)"))
    known = as_columns(columns, default)
    try:
        table = read(path)
    except Exception as error:  # parsers raise errors of many types for damaged files
        if isinstance(error, ImportError) or getattr(error, "errno", None):
            raise
        raise ValueError(f"the log {str(path)!r} cannot be read as {kind}: {brief(error)}") from error
    if known is BETAFLIGHT and BETAFLIGHT.motors[0] not in table:
        known = THROTTLES
    tables = flights(table, known)
    names = [path.stem] if len(tables) == 1 else [f"{path.stem}-{i + 1}" for i in range(len(tables))]
    return [_flown(make_log(name, each, known), known) for name, each in zip(names, tables, strict=True)]


def _flown(log: FlightLog, known: Columns) -> FlightLog:
    """Return a log whose motors turn."""
    if still := [name for name, numbers in zip(known.motors, log.motors.T, strict=True) if not numbers.any()]:
        raise ValueError(f"the log {log.name!r} shows no flight: its motor {still[0]!r} never turns")
    return log


def read_csv(path: Path) -> pd.DataFrame:
    """Return all columns of a CSV file."""
    before, zero, _ = path.read_bytes().partition(b"\0")
    if zero and (row := before.count(b"\n")):  # in the line of names: not UTF-8; pandas before 3.1 skips rows of zeros
        raise ValueError(f"it has zero bytes in row {row}; cut it there")
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # rows with more cells than names
        table = pd.read_csv(path, index_col=False, skipinitialspace=True, low_memory=False)
    return table.rename(columns=str.strip)


def _px4(path: Path) -> pd.DataFrame:
    """Return the columns of `_TOPICS` at the times of the attitude, µs."""
    from pyulog import ULog

    with path.open("rb") as file:
        log = ULog(file, list(_TOPICS))
    found = {data.name: data.data for data in reversed(log.data_list)}  # the first instance of each topic
    if missing := [topic for topic in _TOPICS if topic not in found]:
        raise ValueError(f"it must have the topics {', '.join(_TOPICS)}, but has no {missing[0]}")
    time = found["vehicle_attitude"]["timestamp"].astype(float)
    columns: dict[str, Any] = {"time": time}
    for topic, names in _TOPICS.items():
        stamps = found[topic]["timestamp"].astype(float)
        if (np.diff(stamps) < 0.0).any():
            raise ValueError(f"the time stamps of its topic {topic} go back")
        columns |= {column: np.interp(time, stamps, found[topic][name]) for name, column in names.items()}
    return pd.DataFrame(columns)


def _betaflight(path: Path) -> pd.DataFrame:
    """Return all fields of the flights in a blackbox log, and the throttles of the motors from 0 to 1."""
    from orangebox import Parser

    messages = logging.getLogger("orangebox")
    usual = messages.level
    messages.setLevel(logging.CRITICAL)  # many lines for one damaged frame
    try:
        parser = Parser.load(str(path))
        tables, lost = list[pd.DataFrame](), 0
        for index in range(1, parser.reader.log_count + 1):
            parser.set_log_index(index)
            table = pd.DataFrame([frame.data for frame in parser.frames()], columns=parser.field_names)
            motors = table.filter(regex=r"^motor\[")
            low, high = _DSHOT if motors.min().min() < _PULSES[0] else _PULSES
            throttles = ((motors - low) / (high - low)).clip(0.0, 1.0)
            tables.append(table.join(throttles.rename(columns=lambda name: name.replace("motor", "throttle"))))
            lost += parser._ctx.invalid_frame_count
    finally:
        messages.setLevel(usual)
    if lost:
        print(f"{path}: {lost} damaged frames are left out, and {sum(map(len, tables))} are read.", file=sys.stderr)
    return pd.concat(tables, ignore_index=True)
