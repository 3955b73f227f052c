"""Spaces of observations and actions, and the check of an action."""

from typing import Any

import numpy as np
from gymnasium import spaces

from quadpend_gym.core.arrays import Floats32
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


def check_action(action: Any, shape: tuple[int, ...]) -> Floats32:
    """Return an action of the shape `shape` as a contiguous, aligned and writable float32 array.

    `World.step` checks the range. The kernels only read the action, but numba compiles a kernel again, for ten seconds,
    for a read-only or misaligned array, so such an action is copied.

    Raises:
        ValueError: If `action` has another shape, or does not consist of numbers.
    """
    if type(action) is np.ndarray and action.dtype is _FLOAT32 and action.shape == shape:
        return action if action.flags.carray else np.array(action, order="C")
    array = np.asarray(action)
    if array.shape != shape or array.dtype.kind not in "iuf":
        raise ValueError(f"action must be numbers of shape {shape}, not {action!r}")
    with np.errstate(over="ignore"):  # an overflow gives inf, which `World.step` rejects
        return array.astype(np.float32, order="C")
