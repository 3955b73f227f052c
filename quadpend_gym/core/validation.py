"""Frozen dataclasses as plain data and back, with one sentence for every mistake.

Environment specifications travel as JSON, where a dataclass becomes a mapping and a tuple a list. `build` turns them
back, strictly: unknown or missing fields and wrong types are refused.
"""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record")


def from_plain(kind: type[Record], value: Any, name: str) -> Record:
    """Make a `kind` of `value`, which is one already or a mapping of its fields.

    Args:
        kind: a dataclass.
        value: an instance of `kind`, or a mapping from field names to values.
        name: what the value is called in error messages.

    Raises:
        TypeError: `value` is neither, or misses a field.
        ValueError: `value` has a field that `kind` has not.
    """
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        raise TypeError(f"{name} must be a {kind.__name__} or a mapping of its fields, not {value!r}")
    known = {field.name: field for field in fields(kind) if field.init}  # type: ignore[arg-type]
    if unknown := sorted(set(value) - set(known), key=str):
        raise ValueError(f"{name} has no field {unknown[0]!r}; its fields are {', '.join(known)}")
    for field in known.values():
        if field.name not in value and field.default is MISSING and field.default_factory is MISSING:
            raise TypeError(f"{name} misses the field {field.name!r}")
    hints = get_type_hints(kind)
    return kind(**{key: _restore(hints[key], item, f"{name}.{key}") for key, item in value.items()})


def _restore(hint: Any, item: Any, name: str) -> Any:
    if is_dataclass(hint):
        return from_plain(hint, item, name)  # type: ignore[arg-type]
    return tuple(item) if isinstance(item, list) else item


def to_plain_fields(instance: Any) -> None:
    """Make plain data of a frozen dataclass's fields: numpy's numbers Python's, lists and arrays tuples.

    So that a model is equal to its like, can be hashed, and goes to JSON, whatever it was made from.
    """
    for field in fields(instance):
        object.__setattr__(instance, field.name, _tidied(getattr(instance, field.name)))


def _tidied(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return tuple(_tidied(item) for item in value) if isinstance(value, list | tuple) else value


def check_number(value: Any, name: str, low: float = -np.inf, high: float = np.inf) -> float:
    """Check that `value` is a finite number in [low, high].

    Raises:
        TypeError: it is not a number.
        ValueError: it is not finite or outside the interval.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.number):
        raise TypeError(f"{name} must be a number, not {value!r}")
    if not (np.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name} must be a finite number in [{low:g}, {high:g}], not {value!r}")
    return float(value)


def as_float_array(value: Any, name: str) -> NDArray[Any]:
    """`value` as an array of real numbers.

    Raises:
        TypeError: it is not made of them.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name} must be made of numbers, not {value!r}") from error
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be made of numbers, not {value!r}")
    return array


def check_int(value: Any, name: str, least: int) -> int:
    """Check that `value` is a whole number of at least `least`.

    Raises:
        ValueError: it is not.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, not {value!r}")
    return value


def check_positive(value: Any, name: str) -> float:
    """Check that `value` is a finite number above zero.

    Raises:
        TypeError: it is not a number.
        ValueError: it is not finite or not above zero.
    """
    if check_number(value, name) <= 0.0:
        raise ValueError(f"{name} must be above zero, not {value!r}")
    return float(value)


def check_interval(value: Any, name: str, low: float = -np.inf, high: float = np.inf) -> tuple[float, float]:
    """Check that `value` is a pair (lowest, highest) within [low, high].

    Raises:
        TypeError: it is not a pair of numbers.
        ValueError: a number is out of range or the pair is out of order.
    """
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise TypeError(f"{name} must be a pair (lowest, highest), not {value!r}")
    first, last = (check_number(item, name, low, high) for item in value)
    if first > last:
        raise ValueError(f"{name} must be in order, not {value!r}")
    return first, last


def as_vector(value: Any, size: int, name: str) -> tuple[float, ...]:
    """Check that `value` is a finite number, meant for every component, or a sequence of `size` such numbers.

    Raises:
        TypeError: it is neither a number nor a sequence of `size` numbers.
        ValueError: a number is not finite.
    """
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, int | float | np.number):
        value = [value] * size
    if not isinstance(value, tuple | list) or len(value) != size:
        raise TypeError(f"{name} must be a number or {size} numbers, not {value!r}")
    return tuple(check_number(item, name) for item in value)
