"""Perturbation axes, on which `experiments.robustness` measures policies.

Each axis is one kind of perturbation with values of increasing size. At its nominal value, the scenario is
`QuadPendulum-v0` in calm air, or hover if the start is perturbed. The wind model draws the heading of a wind; the
heading of a perturbed start is a function of the episode's seed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.arrays import Floats
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Noise
from quadpend_gym.wind import Constant, Drawn, Dryden, StillAir

CALM = Scenario()
HOVER_HEIGHT = 2.0  # m, of the hover point above the origin
_GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)  # rad; its multiples are evenly distributed on the circle
_MILLI = 0.001
Fields = dict[str, Any]  # of a `Scenario`


@dataclass(frozen=True)
class PerturbationAxis:
    """One kind of perturbation, of which `values` are ascending."""

    title: str
    unit: str
    values: tuple[float, ...]
    fields: Callable[[float], Fields]  # from a value to the changed fields of the scenario
    # From a value and headings (rad, shape (n,)) to fields of the state; the environment draws the others.
    start: Callable[[float, Floats], dict[str, Floats]] | None = None
    nominal: float = 0.0  # without a perturbation; if it is not the first value, the perturbation grows both ways
    scale: Literal["linear", "symlog"] = "linear"  # in plots

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def scenario(self, value: float) -> Scenario:
        """Return calm air with the perturbation of a value, which no controller knows."""
        return replace(CALM, **self.fields(value), loop_known=False)

    def options(self, value: float, episodes: int, seed: int) -> dict[str, Any] | None:
        """Return the options of `reset` at a value, for `episodes` consecutive seeds from `seed` on."""
        if self.start is None:
            return None
        heading = _GOLDEN_ANGLE * (seed + np.arange(episodes)) % (2.0 * np.pi)
        return {"state": self.start(value, heading)}


def _cylindrical(radius: float, heading: Floats, height: float) -> Floats:
    """Return vectors with cylindrical coordinates, shape (n, 3)."""
    return np.column_stack([radius * np.cos(heading), radius * np.sin(heading), np.full_like(heading, height)])


def _tilted(tilt: float, heading: Floats) -> dict[str, Floats]:
    return {"direction": _cylindrical(np.sin(tilt), heading, np.cos(tilt)), "direction_rate": np.zeros(3)}


def _displaced(distance: float, heading: Floats) -> dict[str, Floats]:
    return {"position": _cylindrical(distance, heading, HOVER_HEIGHT)}


def _steady_force(force: float) -> Fields:
    return {"wind": Drawn(Constant((1.0, 0.0, 0.0)), strength=(force, force))}


def _turbulence(speed: float) -> Fields:
    return {"wind": Drawn(Dryden(speed)) if speed else StillAir()}


def _sensor_noise(size: float) -> Fields:
    """White noise of `size` mm on positions and mrad on angles, and of 10 × `size` mm/s and mrad/s on their rates."""
    error, rate = 0.001 * size, 0.01 * size
    return {"sensors": Noise(error, rate, error, rate, error, rate) if size else ()}


def _action_delay(delay: float) -> Fields:
    """Delay in ms, rounded to whole control periods."""
    steps = round(_MILLI * delay / CALM.period)
    return {"actuators": ActionDelay(steps) if steps else ()}


def _motor_lag(time_constant: float) -> Fields:
    return {"actuators": MotorLag(_MILLI * time_constant) if time_constant else ()}


def _parameter_factor(*names: str) -> Callable[[float], Fields]:
    """Return a function from a factor to true parameters that are the nominal ones times the factor."""

    def fields(factor: float) -> Fields:
        values = {name: factor * getattr(CALM.simulation.parameters, name) for name in names}
        return {"parameters": {name: (value, value) for name, value in values.items()}}

    return fields


_TILTS, _DISTANCES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6), (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
_FORCES, _SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0), (0.0, 5.0, 10.0, 12.5, 15.0, 20.0, 25.0)
_ERRORS, _DELAYS = (0.0, 0.02, 0.05, 0.2, 0.5, 2.0, 5.0), (0.0, 10.0, 20.0, 30.0, 40.0)
_LAGS, _FACTORS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0), (0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)
_MASSES, _ROD = _parameter_factor("quadrotor_mass", "bob_mass"), _parameter_factor("rod_length")
PERTURBATION_AXES = {
    "tilt": PerturbationAxis("initial tilt", "rad", _TILTS, lambda _: {"task": "hover"}, _tilted),
    "offset": PerturbationAxis("initial distance", "m", _DISTANCES, lambda _: {"task": "hover"}, _displaced),
    "wind": PerturbationAxis("steady force", "N", _FORCES, _steady_force),
    "turbulence": PerturbationAxis("Dryden turbulence, W₂₀", "m/s", _SPEEDS, _turbulence),
    "noise": PerturbationAxis("sensor noise", "mm, mrad", _ERRORS, _sensor_noise, scale="symlog"),
    "delay": PerturbationAxis("action delay", "ms", _DELAYS, _action_delay),
    "lag": PerturbationAxis("motor time constant", "ms", _LAGS, _motor_lag, scale="symlog"),
    "mass": PerturbationAxis("true mass / nominal mass", "", _FACTORS, _MASSES, nominal=1.0),
    "rod": PerturbationAxis("true rod length / nominal rod length", "", _FACTORS, _ROD, nominal=1.0),
}
