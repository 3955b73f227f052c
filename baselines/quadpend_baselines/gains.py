"""Gains of the controllers, as data.

`AdrcGains` are by default those of the paper's Section 5, untuned. This project's own choices, where the paper says
nothing: the sign terms are saturations (`ObserverGains`), with ρ above the largest |ϑ̈| that the winds here cause, so
that in flight the observers are linear nearly always; the sampling at 100 Hz (`observers`), with the known inputs' mean
over a period; the torque limits (`quadpend_gym.physics.parameters.Actuators`).

The other gains were found by `quadpend tune` on the training scenarios; `TUNED` has the commands and the scores. Of
each controller's gains it varies those that `quadpend_train.studies.tuning.SPACES` lists.
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

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


@dataclass(frozen=True)
class EstimatorGains:
    """What the Kalman filter of `estimator` believes. In the long run only ratios matter."""

    noise: float = 1e-3  # standard deviation of measured positions (m), angles (rad) and r
    rate_noise: float = 1e-2  # of their rates
    force_walk: float = 3.0  # of the force on the quadrotor, N/√s
    bob_force_walk: float = 0.1  # of the force on the bob, N/√s
    torque_walk: float = 0.1  # N·m/√s


@dataclass(frozen=True)
class FlatnessGains:
    """The flatness-based controller, see `flatness`."""

    position_bandwidth: float = 2.5  # rad/s, of each pair of poles, all of them damped by `damping`
    pendulum_bandwidth: float = 7.0
    attitude_bandwidth: float = 20.0
    damping: float = 0.9
    vertical_bandwidth: float = 6.0  # rad/s, height and yaw
    acceleration: float = 3.0  # m/s², the most that a position error may ask of the bob
    velocity: float = 1.5  # m/s, the most that it may ask
    lean: float = 1.1  # rad, of the thrust
    far_pendulum_bandwidth: float = 4.5  # rad/s, where the pendulum is far from where it should be
    far_attitude_bandwidth: float = 8.0
    near: float = 0.1  # η₀, where the bandwidths are halfway between near and far
    estimator: EstimatorGains = field(default_factory=EstimatorGains)


@dataclass(frozen=True)
class LqrGains:
    """Tolerances of the weights of `lqr`: what counts as much as a full action."""

    position: float = 0.3  # m
    velocity: float = 0.6  # m/s
    angle: float = 0.5  # rad
    angle_rate: float = 3.0  # rad/s
    effort: float = 1.0  # of the action's range
    reach: float = 0.5  # m, the largest horizontal error that is answered as such
    integral: float = 0.0  # m·s; 0: no integrators
    integral_limit: float = 0.5  # m·s
    estimator: EstimatorGains = field(default_factory=EstimatorGains)


@dataclass(frozen=True)
class MppiGains:
    """Model-predictive path-integral control, see `mppi`."""

    feedback: LqrGains = field(default_factory=LqrGains)  # its weights, and the feedback around which is sampled
    samples: int = 33  # futures of each row, odd
    horizon: int = 20  # periods
    steps_per_period: int = 2  # control steps in a period
    knots: int = 5  # of the perturbation
    spread: float = 0.3  # its standard deviation, of the action's range
    temperature: float = 0.1  # λ
    estimator: EstimatorGains = field(default_factory=EstimatorGains)


class Tuning(NamedTuple):
    """How gains were found.

    Attributes:
        command: that finds them.
        score: mean penalised RMSE over the training scenarios in episodes that the search has not seen, mm; a fall
            counts as 1 m. See `quadpend_train.studies.tuning`.
    """

    command: str
    score: float


_PAPER = AdrcGains()
_TUNED_ADRC = AdrcGains(
    horizontal_bandwidth=4.11,
    vertical_bandwidth=7.93,
    damping=0.835,
    mismatch=0.986,
    luenberger=ObserverGains(27.8),
    horizontal=ObserverGains(62.5, switching=361.0),
    vertical=ObserverGains(28.6),
)

# By the names of the controllers.
GAINS: dict[str, Any] = {
    "adrc-paper": _PAPER,
    "adrc-matched": replace(_PAPER, mismatch=1.0),
    "adrc-tuned": _TUNED_ADRC,
    "adrc-linear": replace(_TUNED_ADRC, horizontal=replace(_TUNED_ADRC.horizontal, switching=np.inf)),
    "lqr": LqrGains(
        position=0.185,
        velocity=2.76,
        angle=3.81,
        angle_rate=3.66,
        reach=1.24,
        estimator=EstimatorGains(rate_noise=0.00424, force_walk=0.291, bob_force_walk=0.00324, torque_walk=3.05),
    ),
    "lqi": LqrGains(
        position=0.295,
        velocity=2.27,
        angle=3.01,
        angle_rate=2.79,
        reach=0.639,
        integral=0.215,
        integral_limit=0.694,
        estimator=EstimatorGains(rate_noise=0.00264, force_walk=0.583, bob_force_walk=0.00651, torque_walk=0.0918),
    ),
    "flatness": FlatnessGains(
        position_bandwidth=5.18,
        pendulum_bandwidth=6.72,
        attitude_bandwidth=10.0,
        damping=0.602,
        vertical_bandwidth=4.05,
        acceleration=2.29,
        velocity=0.773,
        lean=1.05,
        far_pendulum_bandwidth=3.48,
        far_attitude_bandwidth=7.08,
        near=0.179,
        estimator=EstimatorGains(rate_noise=0.00393, force_walk=0.177, bob_force_walk=0.345, torque_walk=3.06),
    ),
    "mppi": MppiGains(
        feedback=LqrGains(position=0.254, velocity=1.56, angle=1.47, angle_rate=2.72),
        spread=0.0787,
        temperature=0.332,
        estimator=EstimatorGains(rate_noise=0.0205, force_walk=0.546, bob_force_walk=0.185, torque_walk=1.27),
    ),
}

# Of the gains above that were searched; the others follow from them or are the paper's.
TUNED: dict[str, Tuning] = {
    "adrc-tuned": Tuning("quadpend tune adrc-tuned --trials 600", 272.92),
    "lqr": Tuning("quadpend tune lqr --trials 120", 119.31),
    "lqi": Tuning("quadpend tune lqi --trials 120", 95.05),
    "flatness": Tuning("quadpend tune flatness --trials 250", 25.88),
    "mppi": Tuning("quadpend tune mppi --trials 60 --episodes 16", 33.88),
}

# By the short names that `ADRC` takes.
ADRC_GAINS: dict[str, AdrcGains] = {
    name.removeprefix("adrc-"): gains for name, gains in GAINS.items() if name.startswith("adrc-")
}
