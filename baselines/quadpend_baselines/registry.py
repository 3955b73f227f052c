"""Classical controllers by name, with the gains of `quadpend_baselines.gains`."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from quadpend_baselines.controllers.controller import Controller
from quadpend_baselines.controllers.law import Law
from quadpend_baselines.controllers.output_feedback import OutputFeedback
from quadpend_baselines.gains import DESCRIPTIONS, gains_for, law_of, replace_gains
from quadpend_gym import Simulation
from quadpend_gym.core.files import read_mapping
from quadpend_gym.core.nested import flat
from quadpend_gym.core.settings import suggest

CONTROLLERS = tuple(DESCRIPTIONS)
_FILES = (".json", ".toml")  # ends of the names of files of gains


def controller(name: str, simulation: Simulation | None = None, changes: Mapping[str, Any] | None = None) -> Controller:
    """Return the controller with a name, one of `CONTROLLERS`.

    It is designed for the nominal vehicle, interface and control period of `simulation`; None: the default simulation,
    which has the paper's vehicle. The gains are those of the vehicle, except for `changes`: values by the names of the
    gains, where ``a.b`` is gain b of gain a. These are not scaled to other vehicles.
    """
    if name not in CONTROLLERS:
        raise ValueError(
            f"there is no controller {name!r}{suggest(name, CONTROLLERS)}; there are {', '.join(CONTROLLERS)}"
        )
    return controller_of(name, partial(_gains, name, changes or {}), simulation)


def _gains(name: str, changes: Mapping[str, Any], simulation: Simulation) -> Any:
    try:
        return replace_gains(gains_for(name, simulation), changes)
    except ValueError as error:
        raise ValueError(f"the gains of {name} cannot be changed: {error}") from None


def controller_of(name: str, gains: Any, simulation: Simulation | None = None) -> Controller:
    """Return the controller with a name, with its gains, or a function that returns them for a simulation."""
    law = law_of(name)
    made: Controller = OutputFeedback(law, gains, simulation) if issubclass(law, Law) else law(gains, simulation)
    return made


def gains_file(text: str) -> Path | None:
    """Return the file in a text NAME:FILE, such as ``"lqg:gains.json"``; None if the text is of another form."""
    name, _, path = text.partition(":")
    if path.endswith(_FILES):
        return Path(path)
    if name in CONTROLLERS and (path.endswith((".yaml", ".yml")) or Path(path).is_file()):
        raise ValueError(f"{text}: a file of gains must be a .json or .toml file")
    return None


def controller_from_text(text: str) -> Controller:
    """Return the controller NAME, or NAME:FILE with the gains of a file (.json or .toml), see `controller`.

    The file is one of ``quadpend tune``, or it has the values by the names of the gains, in tables or with dots.
    """
    if (path := gains_file(text)) is None:
        return controller(text)
    name, found = text.partition(":")[0], read_mapping(path)
    if (of := found.pop("controller", name)) != name:
        raise ValueError(f"{path} has the gains of {of}, not of {name}: give {of}:{path}")
    changes = found.get("gains", found)
    if not isinstance(changes, dict) or not changes:
        raise ValueError(f"{path}: gains must be a mapping of names to values, not {changes!r}")
    try:
        return controller(name, changes=flat(changes))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
