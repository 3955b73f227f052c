"""Nested named tuples as flat arrays, because numba unboxes one array faster than a nested tuple at every call."""

from collections import namedtuple
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined

Kind = TypeVar("Kind")
_READ = {float: "packed[{}]", int: "int(packed[{}])", bool: "packed[{}] > 0.0"}


def pack(value: Any) -> Floats:
    """Return the numbers of a named tuple, whose fields are numbers or named tuples, as a flat array."""
    return np.array(_flat(value))


def unpacker(kind: type[Kind]) -> Callable[[Any], Kind]:
    """Return an inlined function that makes a named tuple of the first numbers of an array that `pack` made.

    A settings class stands for a named tuple of its fields; pack its `dataclasses.astuple`.
    """
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
    if get_origin(kind) is tuple:
        return f"({', '.join(_expression(part, names, position) for part in get_args(kind))})"
    hints, make = get_type_hints(kind), cast(Any, namedtuple)
    names[kind.__name__] = kind if issubclass(kind, tuple) else make(kind.__name__, hints)
    return f"{kind.__name__}({', '.join(_expression(hint, names, position) for hint in hints.values())})"
