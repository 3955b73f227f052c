"""Continuous random winds: Ornstein–Uhlenbeck noise and Dryden turbulence.

Dryden turbulence at low altitude follows MIL-F-8785C: the mean wind V at the altitude h carries a frozen
turbulence field with the components u (along the wind), v (across) and w (up). W₂₀ is the wind at 20 feet, and h is in
feet. The roughness length is z₀ = 0.15 feet, the specification's value for terminal flight phases (category C; it is 2
feet for the other categories):

    (1)  V    = W₂₀ ln(h/z₀) / ln(20/z₀)
    (2)  σ_w  = 0.1 W₂₀,     σ_u = σ_v = σ_w / (0.177 + 0.000823 h)^0.4
    (3)  L_w  = h,           L_u = L_v = h / (0.177 + 0.000823 h)^1.2            10 ≤ h ≤ 1000

The spectra are one-sided in ω (rad/s), with the variance ∫₀^∞ Φ dω and T = L/V. In (5), Φ_v follows from Φ_w with σ_v
and T_v in place of σ_w and T_w:

    (4)  Φ_u = (2 σ_u² T_u/π) / (1 + (T_u ω)²)
    (5)  Φ_w = (σ_w² T_w/π) (1 + 3 (T_w ω)²) / (1 + (T_w ω)²)²

MIL-HDBK-1797 halves the lengths across and up (2 L_v = L_u, 2 L_w = h), and writes 2 L where (5) has L. At low
altitude both documents describe the same process.

The mean wind alone carries the field past the quadrotor, and the altitude h is fixed: the turbulence does not depend on
the quadrotor's position and velocity.

(4) and (5) are rational, so their filters are exact.
"""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.settings import Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.wind.base import LARGEST_LOAD, WIND_FIELDS, WINDS, Addable, Load, Loads
from quadpend_gym.wind.filters import (
    DiscreteFilter,
    Filter,
    advance,
    combine,
    discretise,
    draw_stationary,
    from_transfer_function,
    square_root,
)

__all__ = ["Dryden", "OrnsteinUhlenbeck"]

FOOT, KNOT = 0.3048, 0.514444  # m, m/s
INTENSITIES = {"light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}  # W₂₀, m/s, MIL-F-8785C
_ROUGHNESS = 0.15  # feet, z₀
_VELOCITY = np.arange(WIND_FIELDS["velocity"].start, WIND_FIELDS["velocity"].stop)


@WINDS.add
@settings
class OrnsteinUhlenbeck(Loads):
    """Coloured Gaussian noise with exponentially decaying correlation, independent in each axis and stationary.

    The loads are standard deviations σ. The discretisation is exact: d_{k+1} = a d_k + σ √(1 − a²) n_k with
    a = exp(−period / time_constant).
    """

    force: Annotated[Load, Range(0.0, LARGEST_LOAD, "N")] = 0.3  # standard deviation of the force on the quadrotor
    bob_force: Annotated[Load, Range(0.0, LARGEST_LOAD, "N")] = 0.0  # standard deviation of the force on the bob
    torque: Annotated[Load, Range(0.0, LARGEST_LOAD, "N·m")] = 0.0  # standard deviation of the torque on the quadrotor
    velocity: Annotated[Load, Range(0.0, 1e4, "m/s")] = 0.0  # standard deviation of the velocity of the air
    time_constant: Annotated[float, Range(1e-6, 1e6, "s")] = 1.0  # correlation time
    kind: Literal["ornstein_uhlenbeck"] = "ornstein_uhlenbeck"

    @property
    def memory_size(self) -> int:
        """One number for each axis with a load."""
        return len(self.axes)

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw from the stationary distribution."""
        return self.load[self.axes] * streams.normal(0, len(self.axes))

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add the current disturbance, and compute the next one."""
        if self.axes:
            system, output, axes = _discrete_noise(self, period)
            advance(system, output, axes, step, streams, memory, out)


@lru_cache(maxsize=64)
def _discrete_noise(noise: OrnsteinUhlenbeck, period: float) -> tuple[DiscreteFilter, Floats, Integers]:
    """Return the discrete filter, its output matrix and the columns of the output."""
    decay = np.exp(-period / noise.time_constant)
    eye = np.eye(len(noise.axes))
    deviation = noise.load[noise.axes]
    system = DiscreteFilter(decay * eye, np.sqrt(1.0 - decay**2) * deviation * eye)
    return system, eye, np.array(noise.axes)


# Of u, v and w in dimensionless form: the weight in σ √(weight T/π), and the coefficients of N and D, constant first
_SPECTRA = (
    (2.0, [1.0], [1.0, 1.0]),
    *((1.0, [1.0, 3.0**0.5], [1.0, 2.0, 1.0]),) * 2,
)


@WINDS.add
@settings
class Dryden(Addable):
    """Mean wind with Dryden turbulence at low altitude, equations (1)–(5)."""

    # wind speed W₂₀ at 20 feet: a number, or light, moderate or severe for 15, 30 or 45 knots
    intensity: Annotated[Literal["light", "moderate", "severe"] | float, Range(1e-3, 1000.0, "m/s")] = "light"
    # height above the ground, 10 to 1000 feet
    altitude: Annotated[float, Range(10.0 * FOOT, 1000.0 * FOOT, "m")] = 20.0 * FOOT
    # speed V of the mean wind; None: from `intensity` and `altitude`
    mean_wind: Annotated[float | None, Range(1e-3, 1000.0, "m/s")] = None
    heading: Annotated[float, Range(-1000.0, 1000.0, "rad")] = 0.0  # direction of the mean wind, from x towards y
    kind: Literal["dryden"] = "dryden"
    moves_air = True

    @property
    def wind_20_feet(self) -> float:
        """W₂₀, m/s."""
        return INTENSITIES[self.intensity] if isinstance(self.intensity, str) else self.intensity

    @property
    def mean_speed(self) -> float:
        """V, m/s, equation (1)."""
        if self.mean_wind is not None:
            return self.mean_wind
        return float(self.wind_20_feet * np.log(self.altitude / FOOT / _ROUGHNESS) / np.log(20.0 / _ROUGHNESS))

    @property
    def deviations(self) -> Floats:
        """σ_u, σ_v, σ_w, m/s, equation (2)."""
        horizontal = (0.177 + 0.000823 * self.altitude / FOOT) ** -0.4
        return 0.1 * self.wind_20_feet * np.array([horizontal, horizontal, 1.0])

    @property
    def times(self) -> Floats:
        """T_u, T_v, T_w of equations (4) and (5), s: L/V with the lengths of equation (3)."""
        horizontal = self.altitude / (0.177 + 0.000823 * self.altitude / FOOT) ** 1.2
        return np.array([horizontal, horizontal, self.altitude]) / self.mean_speed

    @property
    def filter(self) -> Filter:
        """Filters from white noise to u, v, w (m/s), each with H = σ √(weight T/π) N(Ts)/D(Ts)."""
        axes = zip(_SPECTRA, self.deviations, self.times, strict=True)
        return combine(
            [
                from_transfer_function(numerator, denominator, sigma * np.sqrt(weight * t / np.pi), t)
                for (weight, numerator, denominator), sigma, t in axes
            ]
        )

    @property
    def memory_size(self) -> int:
        """One number for each state of the filters."""
        return int(self.filter.a.shape[0])

    def initial_memory(self, streams: Streams) -> Floats:
        """Draw from the stationary distribution."""
        return draw_stationary(_stationary_root(self), streams)

    def sample(self, out: Floats, memory: Floats, step: Integers, period: float, streams: Streams) -> None:
        """Add mean wind and turbulence at the beginning of the control period; they are constant during the period."""
        system, output, mean = _discrete_turbulence(self, period)
        advance(system, output, _VELOCITY, step, streams, memory, out)
        for axis, value in zip(_VELOCITY[:2], mean, strict=True):
            out[:, axis] += value


@lru_cache(maxsize=64)
def _stationary_root(turbulence: Dryden) -> Floats:
    """Return S of equation (3) in `filters`."""
    return square_root(turbulence.filter.stationary_covariance)


@lru_cache(maxsize=64)
def _discrete_turbulence(turbulence: Dryden, period: float) -> tuple[DiscreteFilter, Floats, Floats]:
    """Return the discrete filter, its output matrix rotated to the heading, and the mean wind along x and y."""
    system = turbulence.filter
    cosine, sine = np.cos(turbulence.heading), np.sin(turbulence.heading)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return discretise(system, period), rotation @ system.c, turbulence.mean_speed * rotation[:2, 0]
