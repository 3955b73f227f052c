"""Horizontal vectors in the rows of arrays."""

import numpy as np

from quadpend_gym.core.arrays import Floats


def rotate(rows: Floats, yaw: Floats, *columns: int) -> Floats:
    """Rows with some of their vectors turned about the vertical.

    Args:
        rows: shape (n, k).
        yaw: angles, rad, shape (n,).
        columns: where an x stands whose y is in the next column; the other columns stay.
    """
    cosine, sine = np.cos(yaw), np.sin(yaw)
    out = rows.copy()
    for x in columns:
        a, b = rows[:, x], rows[:, x + 1]
        out[:, x], out[:, x + 1] = cosine * a - sine * b, sine * a + cosine * b
    return out


def limit_norm(vector: Floats, most: float) -> Floats:
    """Vectors, shape (n, k), made no longer than `most`."""
    size = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.asarray(vector * (most / np.maximum(size, most)))
