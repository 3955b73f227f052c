"""Vehicles as the text of their files."""

import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from quadpend_gym.core.settings import declared


def vehicle_toml(part: Any, comments: Mapping[str, str], text_of: Callable[[Any], str] = json.dumps) -> str:
    """Return a vehicle as TOML with comments by names such as "rotors.thrust"; where there is none, with the unit."""
    return "\n".join(_lines(part, "", comments, text_of)) + "\n"


def _lines(part: Any, prefix: str, comments: Mapping[str, str], text_of: Callable[[Any], str]) -> list[str]:
    """Return the lines of a part whose names begin with `prefix`, those of its own parts last."""
    units, lines, tables = {name: item.unit for name, _, item in declared(type(part))}, list[str](), list[str]()
    for name in (each.name for each in fields(part) if each.name != "name"):
        value, comment = getattr(part, name), comments.get(prefix + name, units.get(name))
        if is_dataclass(value):
            tables += ["", f"[{name}]", *_lines(value, f"{name}.", comments, text_of)]
        elif value is not None:
            lines.append(f"{name} = {text_of(value)}" + f"  # {comment}" * bool(comment))
    return lines + tables
