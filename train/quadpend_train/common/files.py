"""Read TOML and JSON files, and convert results to data for JSON."""

import json
import math
from pathlib import Path
from typing import Any

from quadpend_gym.core.toml import read_toml


def read_mapping(path: Path) -> dict[str, Any]:
    """Return the mapping in a file: JSON if its name ends with ``.json``, else TOML.

    Raises:
        ValueError: If the file is not valid or does not contain a mapping.
    """
    if path.suffix != ".json":
        return read_toml(path)
    return parse_mapping(path.read_text(encoding="utf-8"), str(path))


def parse_mapping(text: str, name: str) -> dict[str, Any]:
    """Return the mapping in a JSON text.

    Args:
        text: JSON text.
        name: Name of the text for error messages.

    Raises:
        ValueError: If the text is not valid or does not contain a mapping.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{name} is not valid JSON: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f"{name} must contain a mapping, not {value!r}")
    return value


def to_json_data(value: Any) -> Any:
    """Convert numbers, named tuples, mappings and lists of them to data for JSON; nan and infinity become None."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: to_json_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_data(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
