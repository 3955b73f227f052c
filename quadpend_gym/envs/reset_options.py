"""The options ``state`` and ``reference`` of `reset`, which fix the start of an episode."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.validation import as_float_array, from_plain
from quadpend_gym.physics.kernel import DIVERGENCE_LIMIT
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.references import Reference


class ResetOptions(NamedTuple):
    """Checked options of a reset of m sub-environments; everything that they do not fix is drawn.

    Attributes:
        state: Fixed fields of the state by name, each of shape (3,) or (m, 3).
        reference: Fixed reference as an array of shape (20,) or (m, 20), or None.
    """

    state: dict[str, Floats]
    reference: Floats | None


NO_OPTIONS = ResetOptions({}, None)


def check_reset_options(state: Any, reference: Any, count: int) -> ResetOptions:
    """Check the options of a reset before the reset changes anything.

    Args:
        state: A mapping from names in `STATE_FIELDS` to arrays of shape (3,) or (count, 3), or None.
        reference: A `Reference`, a mapping of its fields, a sequence of `count` of these, or None.
        count: Number of sub-environments that are reset.

    Raises:
        TypeError: If `state` or `reference` has the wrong type.
        ValueError: If `state` or `reference` has an unknown field, a wrong shape or a value out of range.
    """
    return ResetOptions(_check_state(state, count), _check_reference(reference, count))


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
    if "direction" in checked and not np.linalg.norm(checked["direction"], axis=-1).all():
        raise ValueError("options['state']['direction'] must not contain a zero vector")
    return checked


def _check_reference(reference: Any, count: int) -> Floats | None:
    if reference is None:
        return None
    if isinstance(reference, Sequence) and not isinstance(reference, str):
        if len(reference) != count:
            raise ValueError(f"options['reference'] must be one reference or {count} references, not {len(reference)}")
        return np.array([from_plain(Reference, item, "reference").as_array() for item in reference])
    return from_plain(Reference, reference, "reference").as_array()
