"""The options ``state`` and ``reference`` of `reset`, which fix the start of an episode."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import as_float_array
from quadpend_gym.physics.kernel import DIVERGENCE_LIMIT
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks import Task
from quadpend_gym.tasks.feasibility import check_feasible
from quadpend_gym.tasks.trajectories import Trajectory, as_trajectory
from quadpend_gym.vehicles import Simulation

SHORTEST_DIRECTION = 1e-9  # of a direction before its normalisation


class ResetOptions(NamedTuple):
    """Checked options of a reset of m sub-environments; everything that they do not fix is drawn.

    Attributes:
        state: Fixed fields of the state by name, each of shape (3,) or (m, 3).
        references: Fixed references: one for all sub-environments or one for each; empty: they are not fixed.
    """

    state: dict[str, Floats]
    references: tuple[Trajectory, ...]


NO_OPTIONS = ResetOptions({}, ())


def check_reset_options(state: Any, reference: Any, count: int, simulation: Simulation, task: Task) -> ResetOptions:
    """Check the options of a reset before the reset changes anything.

    Args:
        state: A mapping from names in `STATE_FIELDS` to arrays of shape (3,) or (count, 3), or None.
        reference: Anything that `as_trajectory` accepts, a sequence of `count` of these, or None.
        count: Number of sub-environments that are reset.
        simulation: Simulation settings, for `check_feasible`.
        task: Its limits and its side, for `check_feasible`.

    Raises:
        TypeError: If `state` or `reference` has the wrong type.
        ValueError: If `state` or `reference` has an unknown field, a wrong shape or a value out of range, or a
            reference cannot be flown.
    """
    references = _check_references(reference, count)
    for item in dict.fromkeys(references):
        check_feasible(item, simulation, task.limits, task.side)
    return ResetOptions(_check_state(state, count), references)


def _check_state(state: Any, count: int) -> dict[str, Floats]:
    if state is None:
        return {}
    if not isinstance(state, Mapping):
        raise TypeError(f"options['state'] must be a mapping of state fields, not {state!r}")
    checked = {}
    for name, value in state.items():
        if name not in STATE_FIELDS:
            raise ValueError(f"options['state'] has no field {name!r}; the fields are {', '.join(STATE_FIELDS)}")
        array = as_float_array(value, f"options['state'][{name!r}]").astype(np.float64)
        if array.shape not in {(3,), (count, 3)}:
            raise ValueError(f"options['state'][{name!r}] must have shape (3,) or ({count}, 3), not {array.shape}")
        if not (np.abs(array) < DIVERGENCE_LIMIT).all():
            raise ValueError(
                f"options['state'][{name!r}] must be finite numbers between ±{DIVERGENCE_LIMIT:g}, not {array.tolist()}"
            )
        checked[name] = array
    if "direction" in checked and (np.linalg.norm(checked["direction"], axis=-1) < SHORTEST_DIRECTION).any():
        raise ValueError(
            f"options['state']['direction'] must not contain a zero vector or one shorter than {SHORTEST_DIRECTION:g},"
            f" not {checked['direction'].tolist()}"
        )
    return checked


def _check_references(reference: Any, count: int) -> tuple[Trajectory, ...]:
    if reference is None:
        return ()
    if isinstance(reference, Sequence) and not isinstance(reference, str):
        if len(reference) != count:
            raise ValueError(f"options['reference'] must be one reference or {count} references, not {len(reference)}")
        return tuple(as_trajectory(item, "reference") for item in reference)
    return (as_trajectory(reference, "reference"),)
