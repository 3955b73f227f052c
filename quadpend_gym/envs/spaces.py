"""Spaces of observations and actions, and checks of the arguments of `reset` and `step`."""

from typing import Any

import numpy as np
from gymnasium import spaces

from quadpend_gym.core.arrays import Floats32
from quadpend_gym.core.validation import as_float_array, suggest
from quadpend_gym.physics.state import ACTION_SIZE
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS

_FLOAT32 = np.dtype(np.float32)


def observed_columns(scenario: Scenario) -> Any:
    """Return the columns of the full observation that a scenario has: all, or those without velocities."""
    return OUTPUT_FEEDBACK_COLUMNS if scenario.output_feedback else slice(None)


def observation_space(size: int = OBSERVATION_SIZE) -> spaces.Box:
    """Return the space of one observation of `size` finite numbers; `quadpend_gym.tasks.observation` has the layout."""
    largest = float(np.finfo(np.float32).max)
    return spaces.Box(-largest, largest, (size,), np.float32)


def action_space() -> spaces.Box:
    """Return the space of one action: thrust and the torques about roll, pitch and yaw, scaled to [−1, 1]."""
    return spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)


def check_options(options: dict[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """Check that the options of a reset are a dict with known keys, and return them; None becomes an empty dict.

    Raises:
        TypeError: If `options` is not a dict.
        ValueError: If `options` has an unknown key.
    """
    if options is None:
        return {}
    if not isinstance(options, dict):
        raise TypeError(f"options must be a dict, not {options!r}")
    if unknown := [key for key in options if key not in known]:
        raise ValueError(
            f"there is no option {unknown[0]!r}{suggest(unknown[0], known)}; the options are {', '.join(known)}"
        )
    return options


def check_action(action: Any, shape: tuple[int, ...]) -> Floats32:
    """Check shape and type of an action and return it as a contiguous, aligned and writable float32 array.

    `World.step` checks the range. The kernels only read the action, but numba compiles a kernel again, for ten seconds,
    for a read-only or misaligned array, so such an action is copied.

    Raises:
        TypeError: If `action` does not consist of numbers.
        ValueError: If `action` does not have the shape `shape`.
    """
    if type(action) is np.ndarray and action.dtype is _FLOAT32 and action.shape == shape:
        return action if action.flags.carray else np.array(action, order="C")
    array = as_float_array(action, "action")
    if array.shape != shape:
        raise ValueError(f"action must have shape {shape}, not {array.shape}")
    with np.errstate(over="ignore"):  # an overflow gives inf, which `World.step` rejects
        return array.astype(np.float32, order="C")
