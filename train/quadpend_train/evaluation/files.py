"""The files of policies and scenarios outside the package, which other machines need."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from quadpend_baselines import CONTROLLERS
from quadpend_gym.core.factories import find_factory, is_factory
from quadpend_gym.core.files import parse_mapping, read_mapping
from quadpend_gym.scenarios import find_scenario, split_changes
from quadpend_train.policies.loading import policy_file, policy_names
from quadpend_train.policies.mlp_policy import SHIPPED
from quadpend_train.policies.normalization import statistics_file


def policy_files(names: str) -> list[Path]:
    """Return the files from which policies are loaded, without those of this package, and import own policies.

    Args:
        names: Names as for `quadpend_train.policies.loading.load_policies`.

    Raises:
        ValueError: If there is no such policy.
    """
    found = []
    for name in policy_names(names):
        if is_factory(name):
            find_factory(name)
        elif name not in CONTROLLERS and (path := policy_file(name)).parent != SHIPPED:
            statistics = statistics_file(path) if path.suffix == ".zip" else None
            found += [path, *([statistics] if statistics else [])]
    return found


def scenario_files(names: Iterable[str]) -> list[Path]:
    """Return the files of scenarios and of their vehicles, and import models of the user's own code.

    Args:
        names: Names as for `quadpend_gym.scenarios.find_scenario`.

    Raises:
        ValueError: If there is no such scenario.
    """
    found: set[Path] = set()
    for name in names:
        find_scenario(name)
        base, vehicle, _ = split_changes(name)
        found |= set(_files(parse_mapping(base, "the scenario") if base.lstrip().startswith("{") else base))
        found |= set(_files(vehicle))
    return sorted(found)


def _files(value: Any) -> Iterator[Path]:
    """Yield the TOML and JSON files that are named in nested data, and those that these files name."""
    if isinstance(value, str) and value.endswith((".toml", ".json")) and (path := Path(value)).is_file():
        yield path
        yield from _files(read_mapping(path))
    elif isinstance(value, Mapping):
        yield from _files(list(value.values()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _files(item)
