"""Gains of the controllers, as data.

The bandwidths and dampings are those of the paper's Section 5, untuned. This project's own choices, where the paper
says nothing: the sign terms are saturations (`ObserverGains`), with ρ above the largest |ϑ̈| that the winds here cause,
so that in flight the observers are linear nearly always; the sampling at 100 Hz (`observers`), with the known inputs'
mean over a period; the torque limits (`quadpend_gym.params.Actuators`).
"""

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True)
class ObserverGains:
    """An observer with the characteristic polynomial (s² + 2ζω s + ω²)²."""

    bandwidth: float = 500.0  # ω_n, rad/s
    damping: float = 0.9  # ζ
    switching: float = np.inf  # ρ, the bound of the last correction per second; inf: linear
    layer: float | None = None  # δ, where it saturates; None: ρ / ω_n⁴, sampled; 0: the sign function


@dataclass(frozen=True)
class AdrcGains:
    """ADRC of all four channels."""

    horizontal_bandwidth: float = 7.0  # ω_nc of F_x and F_y, rad/s, Section 5
    vertical_bandwidth: float = 10.0  # ω_nc of height z and yaw ψ, rad/s, Section 5
    damping: float = 0.9  # ζ_c of all, Section 5
    luenberger: ObserverGains = field(default_factory=ObserverGains)  # of F … F⁽³⁾, (46)
    horizontal: ObserverGains = field(default_factory=lambda: ObserverGains(switching=5e6))  # of F⁽⁴⁾ …, ϑ, (47)
    vertical: ObserverGains = field(default_factory=lambda: ObserverGains(switching=1e4))  # of z and ψ, (13), (20)
    mismatch: float = 0.0  # share of ϑ̂/K added to F⁽⁴⁾ (and of its rate to F⁽⁵⁾): 0 as in the paper


_PAPER = AdrcGains()

ADRC_GAINS: dict[str, AdrcGains] = {
    "paper": _PAPER,
    "matched": replace(_PAPER, mismatch=1.0),
}
