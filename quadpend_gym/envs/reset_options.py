"""The options of `reset`: which state and reference an episode starts from."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import as_float_array, from_plain
from quadpend_gym.physics.kernel import DIVERGENCE_LIMIT
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.references import Reference


class ResetOptions(NamedTuple):
    """What a reset fixes of new episodes; the rest is drawn.

    Attributes:
        state: fields of the state, each of shape (3,) or (m, 3).
        reference: shape (20,) or (m, 20), or None to draw it.
    """

    state: dict[str, Floats]
    reference: Floats | None


NO_OPTIONS = ResetOptions({}, None)


def check_reset_options(state: Any, reference: Any, rows: int) -> ResetOptions:
    """Check what the options of a reset fix, before anything changes.

    Args:
        state: a mapping from names in `STATE_FIELDS` to arrays of shape (3,) or (rows, 3), or None.
        reference: a `Reference`, a mapping of its fields, one of these for each row, or None.
        rows: number of rows that begin an episode.

    Raises:
        TypeError: `state` or `reference` is of the wrong type.
        ValueError: one of them has something unknown, a wrong shape or a value out of range.
    """
    return ResetOptions(_check_state(state, rows), _check_reference(reference, rows))


def _check_state(state: Any, rows: int) -> dict[str, Floats]:
    if state is None:
        return {}
    if not isinstance(state, Mapping):
        raise TypeError(f"options['state'] must be a mapping of state fields, not {state!r}")
    checked = {}
    for name, value in state.items():
        if name not in STATE_FIELDS:
            raise ValueError(f"options['state'] has no field {name!r}; the fields are {', '.join(STATE_FIELDS)}")
        array = as_float_array(value, f"options['state'][{name!r}]").astype(np.float64)
        if array.shape not in {(3,), (rows, 3)}:
            raise ValueError(f"options['state'][{name!r}] must have shape (3,) or ({rows}, 3), not {array.shape}")
        if not (np.abs(array) < DIVERGENCE_LIMIT).all():
            raise ValueError(
                f"options['state'][{name!r}] must be finite and below {DIVERGENCE_LIMIT:g}, not {array.tolist()}"
            )
        checked[name] = array
    if "direction" in checked and not np.linalg.norm(checked["direction"], axis=-1).all():
        raise ValueError("options['state']['direction'] must not be zero")
    return checked


def _check_reference(reference: Any, rows: int) -> Floats | None:
    if reference is None:
        return None
    if isinstance(reference, Sequence) and not isinstance(reference, str):
        if len(reference) != rows:
            raise ValueError(f"options['reference'] must be one reference or {rows}, not {len(reference)}")
        return np.array([from_plain(Reference, item, "reference").as_array() for item in reference])
    return from_plain(Reference, reference, "reference").as_array()
