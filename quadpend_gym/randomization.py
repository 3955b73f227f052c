"""Domain randomization: physical parameters drawn for each episode."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.settings import Interval, Parsed, Range, parse, settings, suggest
from quadpend_gym.core.streams import Streams
from quadpend_gym.vehicles import PARAMETER_NAMES, Parameters, Simulation
from quadpend_gym.vehicles.vehicle import FASTEST_LOOP

LOOP_NAMES = ("latency", "rate_loop", "rotor_lag", "thrust")
_Factors = Annotated[Interval | None, Range(0.05, 20.0)]
_Mass = Annotated[Interval | None, Range(1e-10, 1e4, "kg")]
_Inertia = Annotated[Interval | None, Range(1e-10, 1e6, "kg·m²")]
_Area = Annotated[Interval | None, Range(0.0, 100.0, "m²")]


@settings
class ParameterRanges:
    """Intervals of the parameters of an episode, with the names of `Parameters`; None: the nominal value.

    Actions are scaled with the nominal parameters: a heavier quadrotor sinks at zero action.
    """

    quadrotor_mass: _Mass = None
    bob_mass: _Mass = None
    rod_length: Annotated[Interval | None, Range(1e-10, 100.0, "m")] = None
    gravity: Annotated[Interval | None, Range(0.01, 1000.0, "m/s²")] = None
    inertia_roll: _Inertia = None
    inertia_pitch: _Inertia = None
    inertia_yaw: _Inertia = None
    quadrotor_drag_area: _Area = None
    bob_drag_area: _Area = None

    def __post_init__(self) -> None:
        if not any(getattr(self, name) for name in PARAMETER_NAMES):
            raise ValueError(f"at least one parameter must have a range, of {', '.join(PARAMETER_NAMES)}")

    def ranges(self, parameters: Parameters) -> "ParameterRanges":
        """Return these intervals, which do not depend on the nominal parameters."""
        return self

    def draw(self, nominal: Parameters, streams: Streams) -> Floats:
        """Draw the parameters of new episodes, shape (n, 9).

        Each parameter uses its own number of the random stream, so the interval of one parameter does not change the
        values of the others.
        """
        return streams.between(0, *_bounds(self, nominal))


@lru_cache(maxsize=64)
def _bounds(ranges: ParameterRanges, nominal: Parameters) -> tuple[Floats, Floats]:
    pairs = [getattr(ranges, name) or (getattr(nominal, name),) * 2 for name in PARAMETER_NAMES]
    lowest, highest = np.array(pairs).T
    return lowest, highest


@settings
class Around:
    """Intervals of ± `share` around the nominal parameters of an environment."""

    share: Annotated[float, Range(0.0, 0.999)]  # half width of the interval, as a fraction of the nominal value
    names: tuple[str, ...] = ()  # parameters to randomize; if empty, all but gravity

    def __post_init__(self) -> None:
        if unknown := set(self.names) - set(PARAMETER_NAMES):
            raise ValueError(f"there is no parameter {min(unknown)!r}{suggest(min(unknown), PARAMETER_NAMES)}")

    def ranges(self, parameters: Parameters) -> ParameterRanges:
        """Return the intervals around these nominal parameters."""
        names = self.names or tuple(name for name in PARAMETER_NAMES if name != "gravity")
        values = {name: getattr(parameters, name) for name in names}
        pairs = {name: ((1.0 - self.share) * value, (1.0 + self.share) * value) for name, value in values.items()}
        return ParameterRanges(**pairs)


def as_ranges(value: Any) -> ParameterRanges | Around:
    """Return parameter ranges from such, a mapping with a ``share``, or one from names of parameters to pairs."""
    if isinstance(value, Around) or (isinstance(value, Mapping) and "share" in value):
        return parse(Around, value, "ranges")
    return parse(ParameterRanges, value, "ranges")


@settings
class LoopChanges:
    """What changes once within an episode, each drawn uniformly in its interval; None: it stays.

    The numbers hold from the first control step at or after the time `at` on; [0, 0] is the whole episode.
    """

    at: Annotated[Interval, Range(0.0, 1e6, "s")]  # time of the change
    latency: Annotated[Interval | None, Range(0.0, 1.0, "s")] = None  # instead of that of the episode
    thrust: _Factors = None  # factor on thrust and torques instead of that of the episode
    # factor on the thrust of one rotor, which is drawn too, besides that of all rotors
    rotors: Annotated[Interval | None, Range(0.0, 20.0)] = None

    def __post_init__(self) -> None:
        if not (self.latency or self.thrust or self.rotors):
            raise ValueError("at least one of latency, thrust and rotors must be given")


@settings
class LoopRanges:
    """Intervals of what lies between an action and the thrust, drawn for each episode; None: the nominal value.

    Controllers know the nominal values: those of the scenario and its vehicle.
    """

    # time until an action acts; rounded to whole substeps
    latency: Annotated[Interval | None, Range(0.0, 1.0, "s")] = None
    # largest deviation of the latency of a control step from that of the episode
    jitter: Annotated[float, Range(0.0, 1.0, "s")] = 0.0
    rate_loop: _Factors = None  # factor on the time constant of the rate loop
    rotor_lag: _Factors = None  # factor on the time constants of the rotors
    thrust: _Factors = None  # factor on thrust and torques of the same command, as by the battery's voltage
    changes: LoopChanges | None = None  # what changes within the episode; None: nothing

    def __post_init__(self) -> None:
        if not any(getattr(self, name) for name in (*LOOP_NAMES, "jitter", "changes")):
            raise ValueError(f"at least one of {', '.join(LOOP_NAMES)}, jitter and changes must be given")

    def check(self, simulation: Simulation) -> None:
        """Refuse what a simulation does not have, and what its vehicle cannot be."""
        vehicle, rotors, interface = simulation.vehicle, simulation.vehicle.rotors, simulation.interface
        lag = 0.0 if rotors is None else 0.5 * sum(rotors.lags)
        if self.rate_loop and interface != "body_rates":
            raise ValueError(f"loop.rate_loop needs the interface 'body_rates'; that of the scenario is {interface!r}")
        if self.rotor_lag and not lag:
            raise ValueError(
                f"loop.rotor_lag needs rotors with a lag, which the vehicle {vehicle.name!r} does not have"
            )
        if self.changes and self.changes.rotors and rotors is None:
            raise ValueError(f"loop.changes.rotors needs rotors, which the vehicle {vehicle.name!r} does not have")
        fastest, slowest = (self.rate_loop or (1.0,))[0], (self.rotor_lag or (1.0,))[-1]
        constant = fastest * vehicle.rate_loop.time_constant
        if interface == "body_rates" and constant < FASTEST_LOOP * slowest * lag:
            raise ValueError(
                f"loop: the time constant of the rate loop must be at least half the rotors' lag of"
                f" {slowest * lag:g} s, not {constant:g} s"
            )


RangesField = Parsed(as_ranges, lambda: ParameterRanges | Around)  # annotation of a field that holds ranges
