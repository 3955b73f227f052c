"""The options ``state``, ``reference`` and ``parameters`` of `reset`, which fix an episode or its start."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.settings import declared, look_up, plain
from quadpend_gym.physics.plant_kernel import DIVERGENCE_LIMIT
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.randomization import ParameterRanges
from quadpend_gym.scenarios.scenario import Scenario
from quadpend_gym.tasks.feasibility import check_feasible
from quadpend_gym.tasks.trajectories import Trajectory, as_trajectory

_SHORTEST_DIRECTION = 1e-9  # of a direction before its normalisation


class ResetOptions(NamedTuple):
    """Checked options of a reset of m sub-environments; everything that they do not fix is drawn."""

    state: dict[str, Floats]  # fixed fields of the state by name, each of shape (3,) or (m, 3)
    references: tuple[Trajectory, ...]  # one for all sub-environments or one for each; empty: they are not fixed
    parameters: dict[str, Floats]  # fixed physical parameters by name, each of shape () or (m,)


NAMES = ("state", "reference", "parameters")
NO_OPTIONS = ResetOptions({}, (), {})


def read_reset_options(
    options: Mapping[str, Any] | None, known: Sequence[str], count: int, scenario: Scenario
) -> ResetOptions:
    """Check the options of a reset of `count` sub-environments, before the reset changes anything.

    ``state`` maps names in `STATE_FIELDS` to arrays of shape (3,) or (count, 3). ``reference`` is what `as_trajectory`
    takes, or a sequence of `count` of these; the scenario's vehicle must be able to fly it. ``parameters`` maps names
    of `Parameters` to a number or `count` numbers within the limits of `ParameterRanges`.
    """
    given: Mapping[str, Any] = options or {}
    for name in given:
        look_up(dict.fromkeys(known), name, "option")
    references = _references(given.get("reference"), count)
    for item in dict.fromkeys(references):
        check_feasible(item, scenario.simulation, scenario.task.side)
    state, parameters = _mapping(given, "state", "fields of the state"), _mapping(given, "parameters", "parameters")
    fields = {name: _field(name, value, count) for name, value in state.items()}
    return ResetOptions(fields, references, {name: _parameter(name, item, count) for name, item in parameters.items()})


def _mapping(given: Mapping[str, Any], name: str, content: str) -> Mapping[str, Any]:
    value = {} if given.get(name) is None else given[name]
    if not isinstance(value, Mapping):
        raise ValueError(f"options[{name!r}] must be a mapping of {content}, not {plain(value)!r}")
    return value


def _parameter(name: str, value: Any, count: int) -> Floats:
    limits = look_up({field: limits for field, _, limits in declared(ParameterRanges)}, name, "parameter")
    array = _numbers(value)
    if array.shape not in {(), (count,)} or not ((limits.low <= array) & (array <= limits.high)).all():
        several = f", or {count} of them" if count > 1 else ""
        raise ValueError(f"options['parameters'][{name!r}] must be a number {limits}{several}, not {plain(value)!r}")
    return array


def _numbers(value: Any) -> Floats:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return np.empty(0)
    return array.astype(np.float64) if array.dtype.kind in "iuf" else np.empty(0)  # no texts and truth values


def _field(name: str, value: Any, count: int) -> Floats:
    look_up(STATE_FIELDS, name, "field of the state")
    array = _numbers(value)
    if array.shape not in {(3,), (count, 3)} or not (np.abs(array) < DIVERGENCE_LIMIT).all():
        raise ValueError(
            f"options['state'][{name!r}] must be numbers between ±{DIVERGENCE_LIMIT:g} of shape (3,) or ({count}, 3),"
            f" not {plain(value)!r}"
        )
    if name == "direction" and (np.linalg.norm(array, axis=-1) < _SHORTEST_DIRECTION).any():
        raise ValueError(f"options['state']['direction'] must not be zero, not {array.tolist()}")
    return array


def _references(reference: Any, count: int) -> tuple[Trajectory, ...]:
    if reference is None:
        return ()
    if isinstance(reference, Sequence) and not isinstance(reference, str):
        if len(reference) != count:
            raise ValueError(f"options['reference'] must be one reference or {count} references, not {len(reference)}")
        return tuple(as_trajectory(item, "reference") for item in reference)
    return (as_trajectory(reference, "reference"),)
