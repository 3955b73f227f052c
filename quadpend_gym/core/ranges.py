"""Permitted ranges of numbers, declared where the fields of a dataclass are declared.

A field with ``Annotated[float, Range(0.1, 100.0, "m/s²")]`` must be a number from 0.1 to 100 m/s². `check_fields`
checks all such fields of an instance, and `declared_ranges` lists them for the documentation and for tests. The type
inside `Annotated` determines the check:

| type                                         | check                                               |
|----------------------------------------------|-----------------------------------------------------|
| `int`                                        | a whole number in the range                         |
| `float`                                      | a number in the range                               |
| `tuple[float, float]`                        | a pair (lowest, highest), both in the range         |
| `tuple[float, ...]`, `float` or tuple, `Any` | each number in the range, nested in any way         |
| one of these or `None`                       | as the type, and None is permitted                  |
| one of these or `str`                        | as the type, and the dataclass itself checks a text |
"""

from collections.abc import Mapping
from functools import cache
from types import NoneType
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from quadpend_gym.core.settings import Range as Range
from quadpend_gym.core.validation import check_int, check_interval, check_number


class _Check(NamedTuple):
    """The check of one field: its name, its range, the kind of value, and types that are not checked."""

    name: str
    range: Range
    kind: Any
    exempt: tuple[type, ...]


@cache
def _checks(kind: Any) -> tuple[_Check, ...]:
    found = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if get_origin(hint) is Annotated:
            bounds = [item for item in get_args(hint)[1:] if isinstance(item, Range)]
            options = get_args(inner) if _is_union(inner := get_args(hint)[0]) else (inner,)
            exempt = tuple(item for item in options if item in (NoneType, str))
            checked = [item for item in options if item not in exempt]
            found += [_Check(name, item, checked[0] if len(checked) == 1 else Any, exempt) for item in bounds]
    return tuple(found)


def _is_union(hint: Any) -> bool:
    return len(get_args(hint)) > 1 and get_origin(hint) is not tuple


def declared_ranges(kind: Any) -> Mapping[str, Range]:
    """Return the ranges of the fields of a dataclass by name, in the order of the fields."""
    return {check.name: check.range for check in _checks(kind)}


def check_fields(instance: Any, prefix: str = "") -> None:
    """Check every field of a dataclass that declares a `Range`.

    Args:
        instance: Instance of the dataclass.
        prefix: What stands before the names of fields in error messages, such as "pole.".

    Raises:
        TypeError: If a value is not a number, or not a pair.
        ValueError: If a number is not finite or outside its range.
    """
    declared: Any = type(instance)
    for name, bounds, kind, exempt in _checks(declared):
        value = getattr(instance, name)
        if kind is float and type(value) is float and bounds.low <= value <= bounds.high:
            continue  # the usual case, and the fastest
        if not (exempt and isinstance(value, exempt)):
            _check(value, prefix + name, bounds, kind)


def _check(value: Any, name: str, bounds: Range, kind: Any) -> None:
    low, high, unit = bounds.low, bounds.high, bounds.unit
    if kind is int:
        check_int(value, name, int(low), int(high))
    elif get_args(kind) == (float, float):
        check_interval(value, name, low, high, unit)
    elif kind is not float and isinstance(value, tuple | list):
        for item in value:
            _check(item, name, bounds, kind)
    else:
        check_number(value, name, low, high, unit)
