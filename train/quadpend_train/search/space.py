"""Search spaces of settings: a settings file with a range or a list of values in place of a value.

A range is a table ``{low = 1e-4, high = 1e-2, log = true}``; a list has the values to choose from. A search space is
extended to include the settings from which the search starts.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from quadpend_gym.core.files import read_mapping
from quadpend_train.training.settings import TrainSettings, to_mapping, with_values

SPACES = Path(__file__).with_name("search_spaces")


def read_space(path: Path | None, start: TrainSettings) -> tuple[dict[str, BaseDistribution], dict[str, Any]]:
    """Read a search space.

    Args:
        path: The file; None for the search space of the algorithm in this package.
        start: The settings from which the search starts.

    Returns:
        The distributions and the values at the start by the path of the setting, such as ``ppo.n_epochs``. A setting
        that the start leaves to the algorithm starts with the lowest or the first value.
    """
    file, known = path or SPACES / f"{start.algo}.toml", dict(flat(to_mapping(start)))
    if not file.is_file():
        raise ValueError(f"there is no search space {file}: give one with --space")
    read = {name: _distribution(name, given, known.get(name)) for name, given in flat(read_mapping(file))}
    for name, (found, _) in read.items():
        for value in found.choices if isinstance(found, CategoricalDistribution) else (found.low, found.high):
            proposed(start, {name: value})
    return {name: found for name, (found, _) in read.items()}, {name: first for name, (_, first) in read.items()}


def flat(values: Mapping[str, Any], table: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the paths of settings and their values; a range is a value."""
    for name, value in values.items():
        if isinstance(value, dict) and "low" not in value:
            yield from flat(value, f"{table}{name}.")
        else:
            yield f"{table}{name}", value


def _distribution(
    name: str, given: Any, start: Any
) -> tuple[CategoricalDistribution | FloatDistribution | IntDistribution, Any]:
    """Return a distribution that includes the value at the start, and this value."""
    if isinstance(given, list) and given:
        choices, first = [_choice(value) for value in given], _choice(given[0] if start is None else start)
        return CategoricalDistribution(choices if first in choices else [*choices, first]), first
    if not isinstance(given, dict) or not {"low", "high"} <= given.keys() <= {"low", "high", "log"}:
        raise ValueError(f"{name} must be {{low = …, high = …, log = …}} or a list, not {given!r}")
    first = start if isinstance(start, int | float) else given["low"]
    low, high = min(given["low"], first), max(given["high"], first)
    kind = FloatDistribution if isinstance(low, float) or isinstance(high, float) else IntDistribution
    return kind(low, high, log=given.get("log", False)), first


def _choice(value: Any) -> Any:
    """Return a value that Optuna can store: lists become JSON."""
    return json.dumps(value) if isinstance(value, list | tuple) else value


def proposed(start: TrainSettings, values: Mapping[str, Any]) -> TrainSettings:
    """Return settings with the values of a trial."""
    is_json = {name: isinstance(value, str) and value.startswith("[") for name, value in values.items()}
    return with_values(start, {name: json.loads(values[name]) if is_json[name] else values[name] for name in values})
