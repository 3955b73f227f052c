"""The vehicles of `presets.toml`, and vehicles from names, files and mappings."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quadpend_gym.core.files import read_toml
from quadpend_gym.core.validation import from_plain, suggest
from quadpend_gym.vehicles.poles import PRESETS, as_pole
from quadpend_gym.vehicles.vehicle import Vehicle


def _from_mapping(data: Mapping[str, Any]) -> Vehicle:
    return from_plain(Vehicle, {**data, "pole": as_pole(data["pole"])} if "pole" in data else data, "vehicle")


VEHICLES = {name: _from_mapping({"name": name, **data}) for name, data in PRESETS["vehicles"].items()}


def as_vehicle(value: Any) -> Vehicle:
    """Return a vehicle.

    Args:
        value: A `Vehicle`, the name of one in `VEHICLES`, the path of a TOML file (it ends in .toml), or a mapping of
            the fields of `Vehicle`. Without a `name`, a vehicle from a file has the name of the file.

    Raises:
        ValueError: If `value` is none of these, there is no such vehicle or file, or a field is missing, unknown, out
            of its range or of the wrong type. It is no TypeError, since `gymnasium.make` appends all arguments of the
            environment to the message of a TypeError.
    """
    try:
        return _as_vehicle(value)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _as_vehicle(value: Any) -> Vehicle:
    if isinstance(value, Path) or (isinstance(value, str) and value.endswith(".toml")):
        return _from_file(Path(value))
    if isinstance(value, str):
        if value not in VEHICLES:
            raise ValueError(
                f"there is no vehicle {value!r}{suggest(value, VEHICLES)}; there are {', '.join(VEHICLES)}; or give a"
                " TOML file"
            )
        return VEHICLES[value]
    if isinstance(value, Mapping):
        return _from_mapping(value)
    return from_plain(Vehicle, value, "vehicle")


def _from_file(path: Path) -> Vehicle:
    try:
        data = read_toml(path)
    except OSError as error:
        raise ValueError(f"the vehicle file {str(path)!r} cannot be read: {error.strerror}") from error
    try:
        return _from_mapping({"name": path.stem, **data})
    except (TypeError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from error
