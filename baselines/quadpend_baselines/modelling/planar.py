"""Rotation and norm limits of horizontal vectors, stored in the rows of an array."""

import numpy as np

from quadpend_gym.core.arrays import Floats


def rotate(rows: Floats, yaw: Floats, *columns: int) -> Floats:
    """Return a copy of rows, shape (n, k), with some horizontal vectors rotated about the vertical by `yaw`, rad, (n,).

    `columns` are those of the x components; the y component of each vector is in the next column.
    """
    cosine, sine = np.cos(yaw), np.sin(yaw)
    out = rows.copy()
    for column in columns:
        x, y = rows[:, column], rows[:, column + 1]
        out[:, column], out[:, column + 1] = cosine * x - sine * y, sine * x + cosine * y
    return out


def limit_norm(vector: Floats, limit: float) -> Floats:
    """Return vectors, shape (n, k), scaled down so that no norm exceeds `limit`."""
    norm = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.asarray(vector * (limit / np.maximum(norm, limit)))
