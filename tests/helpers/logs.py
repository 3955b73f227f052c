"""Flight logs as files."""

from pathlib import Path

import numpy as np
import pandas as pd

from quadpend_train.flight_logs.log import DEFAULT, FlightLog


def save(log: FlightLog, path: Path) -> None:
    """Write a CSV file with the default columns, and rx, ry, rz for the direction of the pole."""
    vectors = (DEFAULT.position, DEFAULT.velocity, DEFAULT.quaternion, DEFAULT.rate, DEFAULT.motors)
    arrays = (log.position, log.velocity, log.quaternion, log.rate, log.motors)
    table = pd.DataFrame({DEFAULT.time: log.period * np.arange(len(log))})
    for names, array in zip(vectors, arrays, strict=True):
        table[list(names or ())] = array
    if log.pole is not None:
        table[["rx", "ry", "rz"]] = log.pole[:, :3]
    table[log.valid].to_csv(path, index=False)
