"""Nested named tuples as flat arrays, because numba unboxes one array faster than a nested tuple at every call."""

from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, TypeVar, get_type_hints

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined

Kind = TypeVar("Kind")
_READ = {float: "packed[{}]", int: "int(packed[{}])", bool: "packed[{}] > 0.0"}


def pack(value: Any) -> Floats:
    """Return the numbers of a named tuple, whose fields are numbers or named tuples, as a flat array."""
    return np.array(_flat(value))


def unpacker(kind: type[Kind]) -> Callable[[Any], Kind]:
    """Return an inlined function that makes a named tuple of the first numbers of an array that `pack` made."""
    names: dict[str, Any] = {"__name__": __name__}
    exec(f"def unpack(packed):\n    return {_expression(kind, names, count())}", names)
    unpack: Callable[[Any], Kind] = inlined(names["unpack"])
    return unpack


def _flat(value: Any) -> list[float]:
    return [x for item in value for x in _flat(item)] if isinstance(value, tuple) else [float(value)]


def _expression(kind: Any, names: dict[str, Any], position: Iterator[int]) -> str:
    """Return the expression that reads a field; numba cannot compile a loop over fields of different types."""
    if kind in _READ:
        return _READ[kind].format(next(position))
    names[kind.__name__] = kind
    fields = [_expression(field, names, position) for field in get_type_hints(kind).values()]
    return f"{kind.__name__}({', '.join(fields)})"
