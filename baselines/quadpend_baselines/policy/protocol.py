"""What every policy, learned or classical, has in common: the `predict` protocol and the scaling of actions."""

from typing import Any, Protocol

import numpy as np

from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Booleans, Floats, Floats32, Integers


class Policy(Protocol):
    """The protocol of Stable-Baselines3's models, so that its `evaluate_policy` takes a controller as it is."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Floats32, Any]:
        """Action for an observation or for a batch of them.

        Args:
            observation: shape (36,) or (n, 36), laid out as in `quadpend_gym.tasks.observation`, or without velocities (27,).
            state: what the previous call returned; None at first.
            episode_start: rows whose episode has just begun, shape (n,); None: none but at first.
            deterministic: learned policies may draw their action when False.

        Returns:
            The action, shape (4,) or (n, 4), and the policy's memory.
        """


def episode_start_mask(episode_start: Any, first: bool, rows: int) -> Booleans:
    """Mask of the rows that begin an episode, shape (rows,), from the arguments of `predict`."""
    if first or episode_start is None:
        return np.full(rows, first)
    return np.broadcast_to(np.asarray(episode_start, np.bool_), (rows,))


def select_rows(rows: Booleans, then: Any, otherwise: Any) -> Any:
    """`then` in some rows and `otherwise` in the others, through tuples of arrays."""
    if isinstance(then, np.ndarray):
        return np.where(rows.reshape(-1, *[1] * (then.ndim - 1)), then, otherwise)
    parts = [select_rows(rows, a, b) for a, b in zip(then, otherwise, strict=True)]
    return type(then)(*parts) if hasattr(then, "_fields") else tuple(parts)


def replace_rows(rows: Integers, part: Any, whole: Any) -> Any:
    """`whole` but that some of its rows are those of `part`, through tuples of arrays."""
    if isinstance(whole, np.ndarray):
        out = whole.copy()
        out[rows] = part
        return out
    parts = [replace_rows(rows, a, b) for a, b in zip(part, whole, strict=True)]
    return type(whole)(*parts) if hasattr(whole, "_fields") else tuple(parts)


def to_action(command: Floats, simulation: Simulation) -> tuple[Floats32, Floats]:
    """The action that comes closest to a command, and the command that it really gives.

    Args:
        command: thrust (N) and torques τφ, τθ, τψ (N·m), shape (n, 4).
        simulation: what an action means, see `Simulation.command_scale`.
    """
    size = simulation.command_scale
    zero = size * [1.0, 0.0, 0.0, 0.0]
    action = np.clip((command - zero) / size, -1.0, 1.0).astype(np.float32)
    return action, to_command(action, simulation)


def to_command(action: Floats32, simulation: Simulation) -> Floats:
    """Thrust (N) and torques (N·m) that actions of shape (n, 4) stand for."""
    size = simulation.command_scale
    return np.asarray(size * [1.0, 0.0, 0.0, 0.0] + size * action)
