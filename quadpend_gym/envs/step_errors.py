"""Error codes of the step kernel, and the exceptions that Python raises for them.

Compiled code cannot raise an exception with a message that depends on array values, so the kernel returns one integer:
`NO_ERROR`, `action_error(row)` or `wind_error(row)`, where `row` is the index of the sub-environment.
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.jit import compiled, inlined
from quadpend_gym.physics.state import ACTION_SIZE

NO_ERROR = -1
# Largest force (N), torque (N·m) and wind velocity (m/s): the numbers that a step computes from larger ones would
# overflow. Of the winds of this package, only rescaled ones within rescaled ones can be larger.
LARGEST_WIND = 1e20
ROUNDING = 1e-6  # by how much an action may exceed ±1: a few units in the last place of float32


@inlined
def action_error(row: int) -> int:
    """Return the code for an action that is out of range or not finite."""
    return row


@inlined
def wind_error(row: int) -> int:
    """Return the code for a wind that is not finite or larger than `LARGEST_WIND`."""
    return -2 - row


def decode_error(code: int) -> tuple[str, int]:
    """Return the wrong input, ``"action"`` or ``"wind"``, and its row, for an error code other than `NO_ERROR`."""
    return ("action", code) if code > NO_ERROR else ("wind", -2 - code)


def clip_rounding(action: Floats32) -> Floats32:
    """Return the actions; clipped to [−1, 1] if the largest is outside, but by at most `ROUNDING`."""
    largest = np.abs(action).max()
    return np.clip(action, -1.0, 1.0) if 1.0 < largest <= 1.0 + ROUNDING else action


def raise_step_error(code: int, action: Any, wind: Any, action_name: str) -> None:
    """Raise the exception for an error code of the step kernel; return if it is `NO_ERROR`.

    Args:
        code: The return value of the kernel.
        action: The actions that the kernel checked, shape (n, 4).
        wind: The wind that the kernel checked, shape (n, 12).
        action_name: Name of the action in the message.

    Raises:
        ValueError: If an action is out of range or not finite, or if the wind is not finite or too large.
    """
    if code == NO_ERROR:
        return
    source, row = decode_error(code)
    if source == "wind":
        allowed = f"at most {LARGEST_WIND:g} N, N·m and m/s" if np.isfinite(wind[row]).all() else "finite numbers"
        raise ValueError(f"wind must be {allowed}, not {wind[row].tolist()} in sub-environment {row}")
    owner = "" if len(action) == 1 else f" of sub-environment {row}"
    raise ValueError(
        f"{action_name}{owner} must be four numbers in [-1, 1], not {action[row].tolist()}: thrust and torques divided"
        " by their scales; gymnasium.wrappers.ClipAction clips the actions of an agent"
    )


@inlined
def find_error(action: Any, wind: Any) -> int:
    """As `check_inputs`, for compiled functions."""
    for row in range(action.shape[0]):
        for component in range(ACTION_SIZE):
            if not (abs(action[row, component]) <= 1.0):
                return action_error(row)
    too_large = False
    for number in wind.reshape(-1):
        too_large |= not (abs(number) <= LARGEST_WIND)
    if too_large:  # find the sub-environment with a second loop, which the compiler cannot vectorise
        for row in range(wind.shape[1]):
            for component in range(wind.shape[0]):
                if not (abs(wind[component, row]) <= LARGEST_WIND):
                    return wind_error(row)
    return NO_ERROR


@compiled
def check_inputs(action: Floats32, wind: Floats) -> int:
    """Return the error code of the first action that is not in [−1, 1], else of the first wind that is too large.

    Args:
        action: Shape (n, 4).
        wind: Shape (12, n).

    Returns:
        A code of this module, `NO_ERROR` if all are valid.
    """
    return find_error(action, wind)
