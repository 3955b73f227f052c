"""Gains: their declarations, how they change with the vehicle, and the values in ``gains.toml``.

Each law declares its gains beside it; those of the observers stand here. Near hover, all vehicles have the same
equations in units of their own time, length, force and torque:

    rate   √K = √((M + m) g/(M' λ)), at which an upright pole falls       `Parameters.chain_stiffness` of the equivalent
    length g/K, torque I K, force: the weight                             pendulum, see `modelling.equivalent`

A gain in such units is the same number for all vehicles. `Scale` has the power of √K by which a gain is multiplied;
gains without one, such as damping ratios, angles and the noise of the sensors, do not change.

The command ``quadpend tune`` found the gains, except where ``gains.toml`` says that they were set by hand.
``quadpend_train.search.tuning.SEARCH_SPACES`` lists those that it varies, by the names of the fields.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import lru_cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_gym import Parameters, Simulation
from quadpend_gym.core.files import read_toml
from quadpend_gym.core.nested import changed, flat
from quadpend_gym.core.settings import Range, settings, suggest
from quadpend_gym.vehicles import VEHICLES, Vehicle


@dataclass(frozen=True)
class Scale:
    """How a gain changes with the vehicle."""

    rate: float  # power of √K
    per: str = ""  # parameter to which the gain is in proportion
    of: str = ""  # field of the gain that changes so; all of it by default


Bandwidth = Annotated[float, Range(1e-3, 1e6, "rad/s"), Scale(1)]
Damping = Annotated[float, Range(0.01, 100.0)]
Positive = Annotated[float, Range(1e-12, 1e12)]  # its comment has the unit
NotNegative = Annotated[float, Range(0.0, 1e12)]
Angle = Annotated[float, Range(0.01, 1.57, "rad")]
Count = Annotated[int, Range(1, 10_000)]


@settings
class ObserverGains:
    """Gains of an observer with the characteristic polynomial (s² + 2ζω s + ω²)²; see `estimation.observers`."""

    bandwidth: Bandwidth = 500.0  # ω_n
    damping: Damping = 0.9  # ζ
    # ρ, gain of the sign term: limit of the last correction, per second; None: linear observer
    switching: Annotated[float | None, Range(0.0, 1e60)] = None
    # δ, half width of the boundary layer; None: about ρ/ω_n⁴; 0: the sign function
    layer: Annotated[float | None, Range(0.0, 1e60)] = None


@settings
class EstimatorGains:
    """Noise levels of the Kalman filter of `estimation.kalman`; in steady state only their ratios matter.

    They are tuned together with the gains of the controller.
    """

    # Standard deviation of measured positions (m), angles (rad) and r; with `models_loop` the least one, if the known
    # noise of a scenario is larger
    noise: Positive = 1e-3
    rate_noise: Positive = 1e-2  # standard deviation of measured rates, per second
    force_walk: Annotated[NotNegative, Scale(0.5, per="hover_thrust")] = (
        3.0  # random walk of the force on the quadrotor, N/√s
    )
    bob_force_walk: Annotated[NotNegative, Scale(0.5, per="bob_mass")] = (
        0.1  # random walk of the force on the bob, N/√s
    )
    gust_walk: Annotated[NotNegative, Scale(0.5, per="bob_mass")] = (
        0.0  # N/√s, `bob_force_walk` in strong wind, see `estimation.kalman`; 0: the same
    )
    torque_walk: Annotated[NotNegative, Scale(2.5, per="inertia_roll")] = 0.1  # random walk of the torque, N·m/√s
    torque_noise: Annotated[NotNegative, Scale(1.5, per="inertia_roll")] = (
        0.0  # white noise of the torque, N·m·√s; it is larger than that of any wind
    )
    models_loop: bool = False  # whether the gain is designed with the rate loop and the lag of the rotors
    mass_time: NotNegative = 0.0  # s, time constant of the estimate μ̂ of weight to thrust; 0: μ̂ = 1


class Search(NamedTuple):
    """The search that found the gains of a controller."""

    command: str  # the command that repeats the search
    # Mean penalised RMSE over the scenarios of the search, in mm, in episodes that the search did not use. A fall
    # (early termination) counts as 1 m. See `quadpend_train.search.tuning`.
    score: float
    scenarios: Sequence[str] = ("training",)  # scenarios, and sets of scenarios, of the search


class Tuning(NamedTuple):
    """Gains with the vehicle for which they were found."""

    gains: Any
    vehicle: str
    search: Search | None  # None: the paper's, set by hand, or derived from those of another controller


def _with_pole_of(vehicle: Vehicle, other: Vehicle) -> bool:
    """Return whether a vehicle is another one, whatever its pole."""
    names = {item.name for item in fields(Vehicle)} - {"name", "pole"}
    return all(getattr(vehicle, name) == getattr(other, name) for name in names)


# For which simulations the tunings of a group of the file are; those of the first group that has any are taken.
_GROUPS: dict[str, Callable[[Simulation], bool]] = {
    "hanging": lambda simulation: simulation.pendulum == "hanging",
    "hummingbird": lambda simulation: _with_pole_of(simulation.vehicle, VEHICLES["hummingbird"]),
    "rigid": lambda simulation: simulation.vehicle.attitude == "rigid",
    "paper": lambda simulation: True,
}
_NOT_GAINS = ("law", "like", "vehicle", "search", "description")  # keys of the tables in the file
_DATA = read_toml(Path(__file__).with_suffix(".toml"))
DESCRIPTIONS: dict[str, str] = {name: table["description"] for name, table in _DATA["paper"].items()}


def _table(group: str, name: str) -> dict[str, Any]:
    own = _DATA[group][name]
    return {**_table(group, own["like"]), **own} if "like" in own else own


def law_of(name: str) -> Any:
    """Return the class of a controller, or of its law."""
    module, _, kind = _table("paper", name)["law"].partition(".")
    return getattr(import_module(f"quadpend_baselines.controllers.{module}"), kind)


@lru_cache(maxsize=128)
def tuning(name: str, group: str = "paper") -> Tuning:
    """Return the tuning of a controller in a group of the file; a string in a gain is the controller that has it."""
    table = _table(group, name)
    values = {key: value for key, value in table.items() if key not in _NOT_GAINS}
    values |= {key: tuning(value, group).gains for key, value in values.items() if isinstance(value, str)}
    search = _DATA[group][name].get("search")
    gains = get_type_hints(law_of(name))["gains"](**values)
    return Tuning(gains, table["vehicle"], None if search is None else Search(**search))


def tuned(group: str = "paper") -> dict[str, Search]:
    """Return the searches that found the gains of a group, by controller."""
    found = {name: tuning(name, group).search for name in _DATA[group]}
    return {name: search for name, search in found.items() if search is not None}


@lru_cache(maxsize=256)
def gains_for(name: str, simulation: Simulation) -> Any:
    """Return the gains of a controller, a key of `DESCRIPTIONS`, for a nominal simulation.

    They are those of the most particular group of the file. Rigid vehicles have them scaled from the vehicle for which
    they were found. The name of a vehicle does not matter.
    """
    group = next(group for group, fits in _GROUPS.items() if name in _DATA[group] and fits(simulation))
    gains, vehicle, _ = tuning(name, group)
    if simulation.vehicle.attitude != "rigid":
        return gains
    models = (equivalent_model(item).parameters for item in (Simulation(VEHICLES[vehicle]), simulation))
    return scale_gains(gains, *models)


def replace_gains(gains: Any, values: Mapping[str, Any]) -> Any:
    """Return gains with some of them replaced; the path ``a.b`` stands for gain b of gain a."""
    known = flat(asdict(gains))
    for path in values:
        if path not in known:
            raise ValueError(f"there is no gain {path!r}{suggest(path, known)}; there are {', '.join(known)}")
    return changed(gains, values)


def scale_gains(gains: Any, tuned: Parameters, other: Parameters) -> Any:
    """Return the gains for a vehicle from those that were tuned for another, by the design parameters of both."""
    rate = float(np.sqrt(abs(other.chain_stiffness) / tuned.chain_stiffness))
    for name, hint in get_type_hints(type(gains), include_extras=True).items():
        for scale in getattr(hint, "__metadata__", ()):
            path = f"{name}.{scale.of}" if isinstance(scale, Scale) and scale.of else name
            if isinstance(scale, Scale) and (gain := attrgetter(path)(gains)) is not None:
                factor = rate**scale.rate
                if scale.per:
                    factor = factor * getattr(other, scale.per) / getattr(tuned, scale.per)
                gains = changed(gains, {path: factor * gain})
        if is_dataclass(part := getattr(gains, name)):
            gains = replace(gains, **{name: scale_gains(part, tuned, other)})
    return gains
