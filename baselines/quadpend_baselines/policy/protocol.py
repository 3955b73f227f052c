"""The `predict` protocol of learned and classical policies, and the conversion between actions and commands."""

from typing import Any, Protocol

import numpy as np

from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers
from quadpend_gym.physics.plants import plant_of


class Policy(Protocol):
    """The `predict` protocol of Stable-Baselines3.

    A controller with this method can be passed to SB3's `evaluate_policy`.
    """

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Floats32, Any]:
        """Return the action for one observation or for a batch of observations.

        Args:
            observation: Shape (36,) or (n, 36), laid out as in `quadpend_gym.tasks.observation`; without velocities,
                shape (27,) or (n, 27).
            state: The memory that the previous call returned; None in the first call.
            episode_start: Mask of the rows whose episode has just begun, shape (n,). None means that no episode has
                just begun, except in the first call.
            deterministic: False allows a learned policy to sample its action.

        Returns:
            The action, shape (4,) or (n, 4), in [-1, 1], and the memory of the policy.
        """


def episode_start_mask(episode_start: Any, first: bool, rows: int) -> Booleans:
    """Return the mask of the rows whose episode has just begun, shape (rows,).

    Args:
        episode_start: The argument of `predict`.
        first: Whether `predict` is called for the first time, without a memory.
        rows: The number of observations in the batch.
    """
    if first or episode_start is None:
        return np.full(rows, first)
    return np.broadcast_to(np.asarray(episode_start, np.bool_), (rows,))


def select_rows(rows: Booleans, then: Any, otherwise: Any) -> Any:
    """Return `then` in the rows of a mask and `otherwise` in the other rows.

    Args:
        rows: Mask, shape (n,).
        then: Array of n rows, or a (named) tuple of such arrays, nested to any depth.
        otherwise: The same structure as `then`.
    """
    if isinstance(then, np.ndarray):
        return np.where(rows.reshape(-1, *[1] * (then.ndim - 1)), then, otherwise)
    parts = [select_rows(rows, a, b) for a, b in zip(then, otherwise, strict=True)]
    return type(then)(*parts) if hasattr(then, "_fields") else tuple(parts)


def replace_rows(rows: Integers, part: Any, whole: Any) -> Any:
    """Return a copy of `whole` in which some rows are replaced by those of `part`.

    Args:
        rows: Indices of the rows to replace, shape (k,).
        part: Array of k rows, or a (named) tuple of such arrays, nested to any depth.
        whole: The same structure with n rows.
    """
    if isinstance(whole, np.ndarray):
        out = whole.copy()
        out[rows] = part
        return out
    parts = [replace_rows(rows, a, b) for a, b in zip(part, whole, strict=True)]
    return type(whole)(*parts) if hasattr(whole, "_fields") else tuple(parts)


def to_action(command: Floats, simulation: Simulation, rigid: Floats | None = None) -> tuple[Floats32, Floats]:
    """Return the actions for demanded thrust and torques, see `actions_for` of `quadpend_gym.physics.plants`."""
    return plant_of(simulation).actions_for(command, rigid)


def to_command(action: Floats32, simulation: Simulation, rigid: Floats | None = None) -> Floats:
    """Return the thrust and torques of actions, see `command` of `quadpend_gym.physics.plants`."""
    return plant_of(simulation).command(action, rigid)
