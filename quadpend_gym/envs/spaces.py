"""Spaces of observations and actions, and the checks of what the user passes in."""

from typing import Any

import numpy as np
from gymnasium import spaces

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.validation import as_float_array
from quadpend_gym.tasks.observation import OBSERVATION_SIZE

_FLOAT32 = np.dtype(np.float32)


def observation_space(size: int = OBSERVATION_SIZE) -> spaces.Box:
    """The space of one observation, any finite numbers; see `quadpend_gym.tasks.observation` for its layout."""
    largest = float(np.finfo(np.float32).max)
    return spaces.Box(-largest, largest, (size,), np.float32)


def action_space() -> spaces.Box:
    """The space of one action: thrust and the torques about roll, pitch and yaw."""
    return spaces.Box(-1.0, 1.0, (4,), np.float32)


def check_options(options: dict[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """The options of a reset, after a check that all of them are known.

    Raises:
        TypeError: `options` is not a dict.
        ValueError: it has an unknown key.
    """
    if options is None:
        return {}
    if not isinstance(options, dict):
        raise TypeError(f"options must be a dict, not {options!r}")
    if unknown := [key for key in options if key not in known]:
        raise ValueError(f"there is no option {unknown[0]!r}; the options are {', '.join(known)}")
    return options


def check_action(action: Any, shape: tuple[int, ...]) -> Floats32:
    """`action` as a float32 array.

    Raises:
        TypeError: it is not made of numbers.
        ValueError: it has another shape.
    """
    if isinstance(action, np.ndarray) and action.dtype is _FLOAT32 and action.shape == shape:
        return action if action.flags.c_contiguous else np.ascontiguousarray(action)
    array = as_float_array(action, "action")
    if array.shape != shape:
        raise ValueError(f"action must have shape {shape}, not {array.shape}")
    with np.errstate(over="ignore"):  # what overflows is refused as out of range
        return array.astype(np.float32, order="C")
