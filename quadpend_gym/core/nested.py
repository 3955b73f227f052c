"""Values in nested mappings, settings and tuples of models by their dotted paths, such as ``ppo.learning_rate``.

An item of a tuple is named by its index or, if it is a model, by its kind: ``sensors.noise.position``.
"""

from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from typing import Any


def flat(values: Mapping[str, Any], table: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by path."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= flat(value, f"{table}{name}.") if isinstance(value, Mapping) else {f"{table}{name}": value}
    return found


def value_at(values: Any, path: str) -> Any:
    """Return the value at a path."""
    for name in path.split("."):
        if isinstance(values, tuple):
            values = values[_index(values, name, path)]
        else:
            values = values[name] if isinstance(values, Mapping) else getattr(values, name)
    return values


def changed(values: Any, new: Mapping[str, Any]) -> Any:
    """Return nested mappings, settings or tuples with new values by path."""
    for path, value in new.items():
        values = _changed(values, path, path, value)
    return values


def _changed(values: Any, rest: str, path: str, value: Any) -> Any:
    name, _, rest = rest.partition(".")
    if is_dataclass(values) and not isinstance(values, type):
        return replace(values, **{name: _changed(getattr(values, name), rest, path, value) if rest else value})
    if isinstance(values, tuple):
        index = _index(values, name, path)
        new = _changed(values[index], rest, path, value) if rest else value
        return (*values[:index], new, *values[index + 1 :])
    if not isinstance(values, Mapping):
        raise ValueError(f"{path} needs a table with {name!r}, not {values!r}")
    return {**values, name: _changed(values.get(name, {}), rest, path, value) if rest else value}


def _index(values: tuple[Any, ...], name: str, path: str) -> int:
    names = {str(i): i for i in range(len(values))}
    names |= {str(getattr(item, "kind", i)): i for i, item in enumerate(values)}
    if name not in names:
        raise ValueError(f"{path}: there is no {name!r} among {', '.join(names)}")
    return names[name]
