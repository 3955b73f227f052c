"""Axes of trouble: what may grow worse in the world of a policy, from the nominal value outwards.

Every axis starts from the calm of `QuadPendulum-v0`, or from hover where the start is what changes. A push comes from a
heading that is the wind model's to draw, or, at the start, a function of the episode's seed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from quadpend_gym.actuators import ActionDelay, MotorLag
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.parameters import PAPER
from quadpend_gym.sensors import Noise
from quadpend_gym.wind import Constant, Drawn, Dryden, StillAir
from quadpend_train.scenarios import Scenario
from quadpend_train.studies.attraction import CALM_HOVER, HEIGHT

_GOLDEN_ANGLE = np.pi * (3.0 - 5.0**0.5)  # rad; multiples of it go evenly round the circle
_PERIOD = 10.0  # ms


@dataclass(frozen=True)
class Axis:
    """One kind of trouble.

    Attributes:
        title: what grows.
        unit: of the values; empty for factors.
        values: to fly, ascending.
        scenario: the world at a value.
        start: fields of the state (`quadpend_gym.physics.state`) at a value, for headings in rad, shape (n,); the others are
            as drawn. None: all are.
        nominal: the value without trouble, one of `values`; unless it is the first, there is trouble on both sides.
        scale: on which to draw the values.
    """

    title: str
    unit: str
    values: tuple[float, ...]
    scenario: Callable[[float], Scenario]
    start: Callable[[float, Floats], dict[str, Floats]] | None = None
    nominal: float = 0.0
    scale: Literal["linear", "symlog"] = "linear"

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def options(self, value: float, episodes: int, seed: int) -> dict[str, Any] | None:
        """What `reset` takes at a value, for `episodes` seeds that count up from `seed`."""
        if self.start is None:
            return None
        heading = _GOLDEN_ANGLE * (seed + np.arange(episodes)) % (2.0 * np.pi)
        return {"state": self.start(value, heading)}


def _cylinder(radius: float, heading: Floats, height: float) -> Floats:
    """Vectors of a horizontal length towards a heading, shape (n, 3)."""
    return np.column_stack([radius * np.cos(heading), radius * np.sin(heading), np.full_like(heading, height)])


def _tilted(tilt: float, heading: Floats) -> dict[str, Floats]:
    return {"direction": _cylinder(np.sin(tilt), heading, np.cos(tilt)), "direction_rate": np.zeros(3)}


def _displaced(distance: float, heading: Floats) -> dict[str, Floats]:
    return {"position": _cylinder(distance, heading, HEIGHT)}


def _pushed(force: float) -> Scenario:
    return Scenario(wind=Drawn(Constant((1.0, 0.0, 0.0)), strength=(force, force)))


def _turbulent(speed: float) -> Scenario:
    return Scenario(wind=Drawn(Dryden(speed)) if speed else StillAir())


def _noisy(size: float) -> Scenario:
    """White noise of `size` mm on positions, mrad on angles, and ten times that each second on their rates."""
    error, rate = 0.001 * size, 0.01 * size
    return Scenario(sensors=Noise(error, rate, error, rate, error, rate) if size else ())


def _delayed(delay: float) -> Scenario:
    return Scenario(actuators=ActionDelay(round(delay / _PERIOD)) if delay else ())


def _lagging(time_constant: float) -> Scenario:
    return Scenario(actuators=MotorLag(0.001 * time_constant) if time_constant else ())


def _mistaken(*names: str) -> Callable[[float], Scenario]:
    """Plants whose parameters are a factor times those that the controllers believe in."""

    def scenario(factor: float) -> Scenario:
        values = {name: factor * getattr(PAPER, name) for name in names}
        return Scenario(parameters={name: (value, value) for name, value in values.items()})

    return scenario


_TILTS, _DISTANCES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6), (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
_FORCES, _SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0), (0.0, 5.0, 10.0, 12.5, 15.0, 20.0, 25.0)
_ERRORS, _DELAYS = (0.0, 0.02, 0.05, 0.2, 0.5, 2.0, 5.0), (0.0, 10.0, 20.0, 30.0, 40.0)
_LAGS, _FACTORS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0), (0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)
AXES = {
    "tilt": Axis("initial tilt", "rad", _TILTS, lambda _: CALM_HOVER, _tilted),
    "offset": Axis("initial distance", "m", _DISTANCES, lambda _: CALM_HOVER, _displaced),
    "wind": Axis("steady force", "N", _FORCES, _pushed),
    "turbulence": Axis("Dryden turbulence, W₂₀", "m/s", _SPEEDS, _turbulent),
    "noise": Axis("sensor noise", "mm, mrad", _ERRORS, _noisy, scale="symlog"),
    "delay": Axis("delay of the action", "ms", _DELAYS, _delayed),
    "lag": Axis("motors' time constant", "ms", _LAGS, _lagging, scale="symlog"),
    "mass": Axis("true over believed mass", "", _FACTORS, _mistaken("quadrotor_mass", "bob_mass"), nominal=1.0),
    "rod": Axis("true over believed rod length", "", _FACTORS, _mistaken("rod_length"), nominal=1.0),
}
