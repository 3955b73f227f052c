"""Checks of the inputs of a step: actions and wind.

Compiled code cannot raise an exception with a message that depends on array values, so the kernel returns one integer:
`NO_ERROR`, the row of a wrong action, or −2 − row for a wrong wind.
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.state import ACTION_SIZE

NO_ERROR = -1
_LARGEST_WIND = 1e20  # N, N·m and m/s: the numbers that a step computes from larger ones would overflow
_FLOAT32 = np.dtype(np.float32)
ROUNDING = 1e-6  # by how much an action may exceed ±1: a few units in the last place of float32


def clip_rounding(action: Floats32) -> Floats32:
    """Return the actions; clipped to [−1, 1] if the largest is outside, but by at most the rounding of float32."""
    largest = np.abs(action).max()
    return np.clip(action, -1.0, 1.0) if 1.0 < largest <= 1.0 + ROUNDING else action


def check_action(action: Any, shape: tuple[int, ...]) -> Floats32:
    """Return an action of the shape `shape` as a contiguous, aligned and writable float32 array.

    The step checks the range. The kernels only read the action, but numba compiles a kernel again, for ten seconds, for
    a read-only or misaligned array, so such an action is copied.
    """
    if type(action) is np.ndarray and action.dtype is _FLOAT32 and action.shape == shape:
        return action if action.flags.carray else np.array(action, order="C")
    array = np.asarray(action)
    if array.shape != shape or array.dtype.kind not in "iuf":
        raise ValueError(f"action must be numbers of shape {shape}, not {action!r}")
    with np.errstate(over="ignore"):  # an overflow gives inf, which the step rejects
        return array.astype(np.float32, order="C")


def raise_step_error(code: int, action: Floats32, wind: Floats, action_name: str) -> None:
    """Raise ValueError for an error code; actions have the shape (n, 4), the wind (n, 12) or (n, 16)."""
    if code < NO_ERROR:
        row = -2 - code
        raise ValueError(f"wind must be finite numbers below 1e20, not {wind[row].tolist()} in sub-environment {row}")
    owner = "" if len(action) == 1 else f" of sub-environment {code}"
    raise ValueError(
        f"{action_name}{owner} must be four numbers in [-1, 1], not {action[code].tolist()};"
        f" gymnasium.wrappers.{'vector.' if owner else ''}ClipAction clips the actions of an agent"
    )


@compiled
def find_error(action: Any, wind: Any) -> int:
    """Return the error code of the first action that is not in [−1, 1], else of the first wind that is too large.

    Actions have the shape (n, 4), and the wind has the shape (12, n) or (16, n).
    """
    wrong = False
    for row in range(action.shape[0]):
        for component in range(ACTION_SIZE):
            wrong |= not (abs(action[row, component]) <= 1.0)
    for component in range(wind.shape[0]):
        for row in range(wind.shape[1]):
            wrong |= not (abs(wind[component, row]) <= _LARGEST_WIND)
    if wrong:  # find the sub-environment with further loops, which the compiler cannot vectorise
        for row in range(action.shape[0]):
            for component in range(ACTION_SIZE):
                if not (abs(action[row, component]) <= 1.0):
                    return row
        for row in range(wind.shape[1]):
            for component in range(wind.shape[0]):
                if not (abs(wind[component, row]) <= _LARGEST_WIND):
                    return -2 - row
    return NO_ERROR
