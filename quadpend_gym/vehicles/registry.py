"""The vehicles of `presets.toml`, and vehicles from names, files and mappings."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from quadpend_gym.core.files import read_toml
from quadpend_gym.core.settings import Parsed, parse, suggest
from quadpend_gym.vehicles.parts import PRESETS
from quadpend_gym.vehicles.vehicle import Vehicle

VEHICLES = {name: Vehicle(**{"name": name, **data}) for name, data in PRESETS["vehicles"].items()}


def as_vehicle(value: Any) -> Vehicle:
    """Return a vehicle.

    Args:
        value: A `Vehicle`, the name of one in `VEHICLES`, the path of a TOML file (it ends in .toml), a mapping of the
            fields of `Vehicle`, or None for the paper's vehicle.
    """
    if value is None:
        return VEHICLES["paper"]
    if isinstance(value, Path) or (isinstance(value, str) and value.endswith(".toml")):
        return _from_file(Path(value))
    if isinstance(value, str):
        if value not in VEHICLES:
            raise ValueError(
                f"there is no vehicle {value!r}{suggest(value, VEHICLES)}; there are {', '.join(VEHICLES)}; or give a"
                " TOML file"
            )
        return VEHICLES[value]
    return parse(Vehicle, value, "vehicle")


# annotation of a field that holds a vehicle
VehicleField = Parsed(
    as_vehicle, lambda: Literal[tuple(VEHICLES)] | Annotated[str, Field(pattern=r"\.toml$")] | Vehicle
)


def _from_file(path: Path) -> Vehicle:
    try:
        data: Mapping[str, Any] = read_toml(path)
    except OSError as error:
        raise ValueError(f"the vehicle file {str(path)!r} cannot be read: {error.strerror}") from error
    try:
        return Vehicle(**{"name": path.stem, **data})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
