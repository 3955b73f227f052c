"""Values in nested mappings and settings by their dotted paths, such as ``ppo.learning_rate``."""

from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from typing import Any


def flat(values: Mapping[str, Any], table: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by path; a range, which is a mapping with ``low``, is a value."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        is_table = isinstance(value, Mapping) and "low" not in value
        found |= flat(value, f"{table}{name}.") if is_table else {f"{table}{name}": value}
    return found


def changed(values: Any, new: Mapping[str, Any]) -> Any:
    """Return nested mappings or settings with new values by path."""
    for path, value in new.items():
        values = _changed(values, path, path, value)
    return values


def _changed(values: Any, rest: str, path: str, value: Any) -> Any:
    name, _, rest = rest.partition(".")
    if is_dataclass(values) and not isinstance(values, type):
        return replace(values, **{name: _changed(getattr(values, name), rest, path, value) if rest else value})
    if not isinstance(values, Mapping):
        raise ValueError(f"{path} needs a table with {name!r}, not {values!r}")
    return {**values, name: _changed(values.get(name, {}), rest, path, value) if rest else value}
