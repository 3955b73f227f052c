"""The poles of `presets.toml`."""

from pathlib import Path
from typing import Any

from quadpend_gym.core.files import read_toml
from quadpend_gym.core.validation import from_plain, suggest
from quadpend_gym.vehicles.parts import Pole

PRESETS = read_toml(Path(__file__).with_name("presets.toml"))
POLES = {name: from_plain(Pole, data, f"poles.{name}") for name, data in PRESETS["poles"].items()}


def as_pole(value: Any) -> Pole:
    """Return a pole.

    Args:
        value: A `Pole`, a mapping of its fields, or the name of a pole in `POLES`.

    Raises:
        TypeError: If `value` is none of these.
        ValueError: If there is no such pole, or a field is unknown or out of its range.
    """
    if isinstance(value, str):
        if value not in POLES:
            raise ValueError(f"there is no pole {value!r}{suggest(value, POLES)}; there are {', '.join(POLES)}")
        return POLES[value]
    return from_plain(Pole, value, "pole")
