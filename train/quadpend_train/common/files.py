"""Reading settings and scenarios from files, and making JSON of results."""

import json
import math
import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_mapping(path: Path) -> dict[str, Any]:
    """The mapping in a TOML or, by its ending, JSON file.

    Raises:
        ValueError: the file is not valid, or holds something else.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".json":
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{path} is not valid TOML: {error}") from error
    return parse_mapping(text, str(path))


def parse_mapping(text: str, name: str) -> dict[str, Any]:
    """The mapping in a JSON text, which is called `name` in error messages.

    Raises:
        ValueError: the text is not valid, or holds something else.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{name} is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f"{name} must hold a mapping, not {value!r}")
    return value


def to_json_data(value: Any) -> Any:
    """Numbers, named tuples, mappings and lists of them as JSON has them, which knows no nan and no infinity."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: to_json_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_data(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
