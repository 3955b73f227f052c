"""Settings: frozen dataclasses whose fields declare their type, range and unit once.

    @settings
    class Pole:
        mass: Annotated[float, Range(1e-5, 1e3, "kg")]  # m
        length: Annotated[float, Range(0.01, 20.0, "m")] = 0.3  # l, pivot to centre of mass

pydantic reads the declaration. It checks the arguments of the constructor and the data of a file, and makes the JSON
schema. NumPy numbers and arrays count as numbers and tuples, a mapping as an instance of the dataclass of its field.
Wrong data raise ValueError with one sentence that names the field, its value, and what it may be. What depends on
several fields is checked in ``__post_init__``.
"""

import functools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
)
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError
from pydantic_core.core_schema import no_info_plain_validator_function, no_info_wrap_validator_function
from typing_extensions import dataclass_transform

Settings = TypeVar("Settings")
Value = TypeVar("Value")
_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False)
_PARTS = {"tuple": "items_schema", "union": "choices"}  # of a schema of pydantic
_PARTS |= dict.fromkeys(("nullable", "function-after", "function-before"), "schema")
_LONGEST = 200  # characters of a value in a sentence


@dataclass(frozen=True)
class Range:
    """Smallest and largest permitted value of every number in a field, and the unit."""

    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        return f"from {self.low:g} to {self.high:g}{self.unit and f' {self.unit}'}"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        message = f"Input should be {_noun(schema)} {self}"

        def check(value: Any, handler: Any) -> Any:
            try:
                return handler(value)
            except ValidationError as error:
                order = [item["ctx"]["error"] for item in error.errors() if item["type"] == "value_error"]
                raise order[0] if order else PydanticCustomError("range", message) from None

        return no_info_wrap_validator_function(check, self._limited(schema))

    def _limited(self, schema: Any) -> Any:
        """Return a schema whose numbers must be in the range."""
        if schema["type"] in ("float", "int"):
            return {**schema, "strict": True, "ge": self.low, "le": self.high}
        if (name := _PARTS.get(schema["type"])) is None:
            return schema
        inner = schema[name]
        return {**schema, name: [self._limited(part) for part in inner] if name != "schema" else self._limited(inner)}

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        found: dict[str, Any] = dict(handler(schema))
        return {**found, "unit": self.unit} if self.unit else found


def _noun(schema: Any) -> str:
    """Return what a schema accepts, such as "a finite number or 3 finite numbers"."""
    kind = schema["type"]
    if kind == "tuple":
        count = "" if "variadic_item_index" in schema else f"{len(schema['items_schema'])} "
        inner = _noun(schema["items_schema"][0])
        return f"{count}rows of {inner}" if inner.endswith("s") else f"{count}{inner.removeprefix('a ')}s"
    if kind == "union":
        return " or ".join(map(_noun, schema["choices"]))
    if kind in _PARTS:
        return ("None or " if kind == "nullable" else "") + _noun(schema["schema"])
    return {"int": "a whole number", "literal": "a name"}.get(kind, "a finite number")


def _in_order(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"the numbers must be in the order (lowest, highest), not {pair}")
    return pair


Interval = Annotated[tuple[float, float], AfterValidator(_in_order)]  # (lowest, highest)


@dataclass(frozen=True)
class Parsed:
    """Annotation of a field whose value a function makes, such as ``Annotated[Any, Parsed(as_wind, …)]``."""

    function: Callable[[Any], Any]  # converts what a user gives; it raises ValueError for wrong data
    accepted: Callable[[], Any]  # returns the type of what it accepts, for the JSON schema

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_plain_validator_function(self.function)

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if self.accepted in _DESCRIBED:  # a wind within a wind
            return {}
        _DESCRIBED.append(self.accepted)
        try:
            return dict(handler(TypeAdapter(self.accepted()).core_schema))
        finally:
            _DESCRIBED.remove(self.accepted)


_DESCRIBED: list[Callable[[], Any]] = []


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def settings(kind: type[Settings]) -> type[Settings]:
    """Make a frozen dataclass whose fields are checked, see the module."""
    made: Any = pydantic_dataclass(frozen=True, config=_CONFIG)(kind)
    construct = made.__init__

    @functools.wraps(construct)
    def checked(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            construct(self, *map(plain, args), **{name: plain(value) for name, value in kwargs.items()})
        except ValidationError as error:
            errors = error.errors(include_url=False)
            unknown = [item for item in errors if item["type"].startswith("unexpected")]
            raise ValueError(_sentence(made, (unknown or errors)[0])) from None

    made.__init__ = checked
    return made  # type: ignore[no-any-return]


def parse(kind: type[Settings], value: Any, name: str) -> Settings:
    """Return an instance of a settings class from an instance or a mapping; `name` is for the sentence on bad data."""
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a {kind.__name__} or a mapping of its fields, not {value!r}")
    try:
        return kind(**value)
    except ValueError as error:
        raise ValueError(re.sub(rf"^{kind.__name__}\b", lambda _: name, str(error))) from None


def _sentence(kind: Any, error: ErrorDetails) -> str:
    """Return the first error of pydantic as a sentence."""
    names = [item.name for item in fields(kind) if item.init]
    first, *rest = error["loc"] or ("",)
    first = names[first] if isinstance(first, int) and first < len(names) else first
    # pydantic inserts the names of the classes of nested dataclasses and the branches of unions in brackets
    path = ".".join(str(part) for part in (kind.__name__, first, *rest) if "[" not in str(part))
    value, what = error["input"], error["msg"].replace("Input should", "must", 1)
    if error["type"] in ("unexpected_keyword_argument", "unexpected_positional_argument"):
        owner, _, name = path.rpartition(".")
        places = owner.split(".")[1:]
        known = _fields_at(kind, places)
        nested = [f"{part}.{name}" for part in known if name in _fields_at(kind, [*places, part])]
        hint = f" (did you mean {nested[0]!r}?)" if nested else suggest(name, known)
        listed = f"; its fields are {', '.join(known)}" if known else ""
        return f"{owner} has no field {name!r}{hint}{listed}"
    if error["type"] in ("missing", "missing_argument"):
        owner, _, name = path.rpartition(".")
        return f"{owner} lacks the field {name!r}"
    if error["type"] in ("value_error", "assertion_error"):
        inner = str(error["ctx"]["error"])
        return f"{path}: {inner}" if first else inner
    text = repr(value)
    return f"{path} {what}, not {text if len(text) <= _LONGEST else text[:_LONGEST] + '…'}"


def _fields_at(kind: Any, path: Iterable[str]) -> list[str]:
    """Return the fields of the settings class at a path of fields; none where it is no class or one of several."""
    for name in path:
        hint = get_type_hints(kind).get(name)
        kinds = [each for each in (hint, *get_args(hint)) if is_dataclass(each)]
        if len(kinds) != 1:
            return []
        (kind,) = kinds
    return [item.name for item in fields(kind) if item.init]


def plain(value: Any) -> Any:
    """Return NumPy numbers as numbers, lists and arrays as tuples, and other values as they are."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if type(value) in (list, tuple):
        return tuple(plain(item) for item in value)
    return value


def suggest(value: Any, known: Iterable[str]) -> str:
    """Return " (did you mean 'windy'?)" with the known name most similar to `value`, or "" if none is similar."""
    similar = get_close_matches(str(value), list(known), 1)
    return f" (did you mean {similar[0]!r}?)" if similar else ""


def look_up(table: Mapping[str, Value], name: str, what: str, more: str = "") -> Value:
    """Return the value of a name in a table; `what` it is and `more` that may be given are for the error message."""
    if name not in table:
        raise ValueError(f"there is no {what} {name!r}{suggest(name, table)}; there are {', '.join(table)}{more}")
    return table[name]


def declared(kind: Any) -> Iterator[tuple[str, Any, Range]]:
    """Yield name, type and range of every field of a settings class that declares a range."""
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if get_origin(hint) is Annotated:
            yield from ((name, get_args(hint)[0], item) for item in get_args(hint)[1:] if isinstance(item, Range))
