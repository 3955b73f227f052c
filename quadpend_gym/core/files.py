"""Read TOML and JSON files."""

import json
import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_toml(path: Path) -> dict[str, Any]:
    """Return the mapping in a TOML file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from error


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the mapping in a file: JSON if its name ends with ``.json``, else TOML."""
    return parse_mapping(path.read_bytes(), str(path)) if path.suffix == ".json" else read_toml(path)


def parse_mapping(text: str | bytes, name: str) -> dict[str, Any]:
    """Return the mapping in a JSON text, which error messages call `name`."""
    try:
        value = json.loads(text, object_pairs_hook=_mapping)
    except ValueError as error:  # also of a text that is not UTF-8
        raise ValueError(f"{name} is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f"{name} must contain a mapping, not {value!r}")
    return value


def readable(path: object) -> str:
    """Return a path as text with "?" for what is not UTF-8, such as letters of a name in Latin-1."""
    return str(path).encode(errors="replace").decode()


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the mapping of pairs, whose keys must differ."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"a mapping has the key {key!r} twice")
        found[key] = value
    return found
