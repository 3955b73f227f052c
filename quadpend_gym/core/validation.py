"""Checks of arguments, and conversion between frozen dataclasses and plain data.

Environment specifications are stored as JSON, in which a dataclass is a mapping and a tuple is a list. `from_plain`
converts them back and raises an error for unknown fields, missing fields and wrong types. Every error message is one
sentence that names the argument, its value and the permitted values.
"""

import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from quadpend_gym.core.settings import suggest as suggest

Dataclass = TypeVar("Dataclass")
_LARGEST = sys.float_info.max


def from_plain(kind: type[Dataclass], value: Any, name: str) -> Dataclass:
    """Convert plain data to an instance of a dataclass.

    Args:
        kind: Dataclass.
        value: Instance of `kind`, which is returned as it is, or mapping from field names to values.
        name: Name of the value in error messages.

    Raises:
        TypeError: If `value` is neither, or lacks a field without a default.
        ValueError: If `value` has a field that `kind` does not have.
    """
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        raise TypeError(f"{name} must be a {kind.__name__} or a mapping of its fields, not {value!r}")
    known = {field.name: field for field in fields(kind) if field.init}  # type: ignore[arg-type]
    if unknown := sorted(set(value) - set(known), key=str):
        raise ValueError(
            f"{name} has no field {unknown[0]!r}{suggest(unknown[0], known)}; its fields are {', '.join(known)}"
        )
    for field in known.values():
        if field.name not in value and field.default is MISSING and field.default_factory is MISSING:
            raise TypeError(f"{name} lacks the field {field.name!r}")
    hints = get_type_hints(kind)
    return kind(**{key: _restore(hints[key], item, f"{name}.{key}") for key, item in value.items()})


def _restore(hint: Any, item: Any, name: str) -> Any:
    if is_dataclass(hint):
        return from_plain(hint, item, name)  # type: ignore[arg-type]
    return tuple(item) if isinstance(item, list) else item


def to_plain_fields(instance: Any) -> None:
    """Convert the fields of a frozen dataclass in place: NumPy scalars to Python numbers, lists and arrays to tuples.

    Instances with the same values then compare equal, are hashable and can be written as JSON, independently of the
    types that they were created with.
    """
    for field in fields(instance):
        object.__setattr__(instance, field.name, _plain(getattr(instance, field.name)))


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value


def check_number(value: Any, name: str, low: float = -np.inf, high: float = np.inf, unit: str = "") -> float:
    """Return `value` as a float after checking that it is a finite number in [low, high].

    Args:
        value: The number.
        name: Its name in error messages.
        low: Smallest permitted value.
        high: Largest permitted value.
        unit: Its unit in error messages, such as "m".

    Raises:
        TypeError: If `value` is not a number.
        ValueError: If `value` is not finite or outside the interval.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.number):
        raise TypeError(f"{name} must be a number, not {value!r}")
    plain = value.item() if isinstance(value, np.generic) else value
    if not (low <= plain <= high and abs(plain) <= _LARGEST):  # without conversion to float, for very large integers
        allowed = f"[{low:g}, {high:g}]{unit and f' {unit}'}"
        raise ValueError(f"{name} must be a finite number in {allowed}, not {_as_text(value)}")
    return float(value)


def as_float_array(value: Any, name: str) -> NDArray[Any]:
    """Return `value` as an array after checking that it contains real numbers only.

    The type of the numbers is kept.

    Raises:
        TypeError: If `value` contains anything else.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name} must contain only numbers, not {value!r}") from error
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name} must contain only numbers, not {value!r}")
    return array


def check_int(value: Any, name: str, least: int, most: int | None = None) -> int:
    """Return `value` after checking that it is an integer of at least `least` and at most `most`.

    Raises:
        ValueError: If it is not.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least or (most is not None and value > most):
        allowed = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name} must be a whole number {allowed}, not {_as_text(value)}")
    return value


def _as_text(value: Any) -> str:
    """Return a value as text for an error message; an integer of many digits as "about 1e30"."""
    if isinstance(value, int) and abs(value) >= 10**15:  # Python refuses to print integers of over 4300 digits
        return f"about {'-' if value < 0 else ''}1e{int(value.bit_length() * np.log10(2.0))}"
    return repr(value)


def check_positive(value: Any, name: str) -> float:
    """Return `value` as a float after checking that it is a finite number above zero.

    Raises:
        TypeError: If `value` is not a number.
        ValueError: If `value` is not finite or not above zero.
    """
    if check_number(value, name) <= 0.0:
        raise ValueError(f"{name} must be above zero, not {value!r}")
    return float(value)


def check_interval(
    value: Any, name: str, low: float = -np.inf, high: float = np.inf, unit: str = ""
) -> tuple[float, float]:
    """Return `value` as a pair of floats after checking that it is a pair (lowest, highest) within [low, high].

    The arguments are those of `check_number`.

    Raises:
        TypeError: If `value` is not a pair of numbers.
        ValueError: If a number is outside [low, high], or the first number is larger than the second.
    """
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise TypeError(f"{name} must be a pair (lowest, highest), not {value!r}")
    first, last = (check_number(item, name, low, high, unit) for item in value)
    if first > last:
        raise ValueError(f"{name} must be in the order (lowest, highest), not {value!r}")
    return first, last


def as_vector(value: Any, size: int, name: str) -> tuple[float, ...]:
    """Return `value` as a tuple of `size` floats after checking that all are finite.

    Args:
        value: One number for all components, or a sequence of `size` numbers.
        size: Number of components.
        name: Name of the value in error messages.

    Raises:
        TypeError: If `value` is neither a number nor a sequence of `size` numbers.
        ValueError: If a number is not finite.
    """
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, int | float | np.number):
        value = [value] * size
    if not isinstance(value, tuple | list) or len(value) != size:
        raise TypeError(f"{name} must be a number or {size} numbers, not {value!r}")
    return tuple(check_number(item, name) for item in value)
