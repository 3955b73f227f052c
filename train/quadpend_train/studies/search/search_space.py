"""Search spaces of settings: a settings file with a range or a list of values in place of a value.

A range is a table ``{low = 1e-4, high = 1e-2, log = true}``, of whole numbers if the setting is one; a list has the
values to choose from. A search space is extended to include the settings from which the search starts.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from optuna import Trial
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from quadpend_gym.core.files import read_mapping
from quadpend_gym.core.validation import check_int, check_number, suggest
from quadpend_train.training.settings import TrainSettings, from_mapping, to_mapping

SPACES = Path(__file__).with_name("search_spaces")
_LARGEST = 2**53  # of whole numbers
_RANGE = {"low", "high", "log"}

Space = Mapping[str, BaseDistribution]  # by the path of the setting, such as "ppo.n_epochs"


def read_space(path: Path | None, start: TrainSettings) -> dict[str, BaseDistribution]:
    """Read a search space.

    Args:
        path: The file; None for the search space of the algorithm in this package.
        start: The settings from which the search starts.

    Raises:
        ValueError: If the file has an unknown setting, or a value that is not permitted.
    """
    file = path or SPACES / f"{start.algo}.toml"
    known = dict(_flat(to_mapping(start)))
    space: dict[str, BaseDistribution] = {}
    for name, given in _flat(read_mapping(file)):
        if name not in known:
            raise ValueError(
                f"{file} has {name!r}, which is not a setting of {start.algo}{suggest(name, known)}; the settings are"
                f" {', '.join(known)}"
            )
        try:
            space[name] = _distribution(given, known[name])
            for value in _extremes(space[name]):
                with_values(start, {name: value})
        except (ValueError, TypeError) as error:
            raise ValueError(f"{file}: {name} is not a permitted range or list of values: {error}") from error
    if not space:
        raise ValueError(f"{file} must have at least one range or list of values")
    return space


def _flat(values: Mapping[str, Any], table: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the paths of settings and their values; a range is a value."""
    for name, value in values.items():
        if isinstance(value, dict) and not value.keys() & {"low", "high"}:
            yield from _flat(value, f"{table}{name}.")
        else:
            yield f"{table}{name}", value


def _distribution(given: Any, start: Any) -> BaseDistribution:
    if isinstance(given, list) and given:
        choices = [_choice(value) for value in given]
        first = _choice(start)
        return CategoricalDistribution(choices if first in choices else [*choices, first])
    if not isinstance(given, dict) or not {"low", "high"} <= given.keys() <= _RANGE:
        raise ValueError(f"it must be {{low = …, high = …, log = …}} or a list, not {given!r}")
    if isinstance(start, bool) or not isinstance(start, int | float):
        raise ValueError(f"the setting is {start!r}, not a number: give a list")
    for end in ("low", "high"):
        _ = check_int(given[end], end, -_LARGEST) if isinstance(start, int) else check_number(given[end], end)
    low, high, log = min(given["low"], start), max(given["high"], start), bool(given.get("log", False))
    kind = IntDistribution if isinstance(start, int) else FloatDistribution
    return kind(low, high, log=log)


def _choice(value: Any) -> Any:
    """Return a value that Optuna can store: lists become JSON."""
    return json.dumps(value) if isinstance(value, list | tuple) else value


def _extremes(distribution: BaseDistribution) -> list[Any]:
    if isinstance(distribution, CategoricalDistribution):
        return list(distribution.choices)
    assert isinstance(distribution, FloatDistribution | IntDistribution)
    return [distribution.low, distribution.high]


def start_values(space: Space, start: TrainSettings) -> dict[str, Any]:
    """Return the values that the settings of the start have in a search space."""
    known = dict(_flat(to_mapping(start)))
    return {name: _choice(known[name]) for name in space}


def suggest_values(trial: Trial, space: Space) -> dict[str, Any]:
    """Return the values that a trial proposes."""
    values: dict[str, Any] = {}
    for name, distribution in space.items():
        if isinstance(distribution, CategoricalDistribution):
            values[name] = trial.suggest_categorical(name, distribution.choices)
        elif isinstance(distribution, IntDistribution):
            values[name] = trial.suggest_int(name, distribution.low, distribution.high, log=distribution.log)
        elif isinstance(distribution, FloatDistribution):
            values[name] = trial.suggest_float(name, distribution.low, distribution.high, log=distribution.log)
    return values


def with_values(start: TrainSettings, values: Mapping[str, Any]) -> TrainSettings:
    """Return settings with the values of a trial.

    Raises:
        ValueError: If a value is out of range, or contradicts another one.
    """
    settings = to_mapping(start)
    for path, value in values.items():
        *tables, name = path.split(".")
        table = settings
        for part in tables:
            table = table[part]
        table[name] = json.loads(value) if isinstance(table[name], list | tuple) else value
    return from_mapping(settings, "the trial")
