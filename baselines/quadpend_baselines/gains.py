"""Gains of the controllers: their declarations; the values are data in ``gains.toml``.

The defaults of `AdrcGains` are those of the paper's Section 5, not tuned. Where the paper gives no values, this
project chooses them: a saturation replaces the sign term (`ObserverGains`), with ρ above the largest |ϑ̈| of this
project's winds, so that the observers rarely leave the boundary layer; the sampling period is 10 ms, and the observers
use the mean of the known inputs over it (`observers`); the torques are limited.

All other gains were found by the command ``quadpend tune``, except where ``gains.toml`` says that they were set by
hand. ``quadpend_train.search.tuning.SEARCH_SPACES`` lists the gains that it varies, by the names of the fields.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from quadpend_gym.core.files import read_toml
from quadpend_gym.core.settings import Range, settings

Bandwidth = Annotated[float, Range(1e-3, 1e6, "rad/s")]
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
class AdrcGains:
    """Gains of `controllers.adrc`."""

    horizontal_bandwidth: Bandwidth = 7.0  # ω_nc of F_x and F_y, Section 5
    vertical_bandwidth: Bandwidth = 10.0  # ω_nc of height z and yaw ψ, Section 5
    damping: Damping = 0.9  # ζ_c of all channels, Section 5
    luenberger: ObserverGains = ObserverGains()  # of F … F⁽³⁾, (46)
    horizontal: ObserverGains = ObserverGains(switching=5e6)  # of F⁽⁴⁾ …, ϑ, (47)
    vertical: ObserverGains = ObserverGains(switching=1e4)  # of z and ψ, (13), (20)
    # Share of the estimate δ̂ in F⁽⁴⁾, and of its rate in F⁽⁵⁾; 0: the paper's law, without δ̂
    mismatch: Annotated[float, Range(0.0, 10.0)] = 0.0
    predicts: bool = True  # whether known delays and lags of the loop are predicted through


@settings
class EstimatorGains:
    """Noise levels of the Kalman filter of `estimation.kalman`; in steady state only their ratios matter.

    They are tuned together with the gains of the controller.
    """

    # Standard deviation of measured positions (m), angles (rad) and r; with `models_loop` the least one, if the known
    # noise of a scenario is larger
    noise: Positive = 1e-3
    rate_noise: Positive = 1e-2  # standard deviation of measured rates, per second
    force_walk: NotNegative = 3.0  # random walk of the force on the quadrotor, N/√s
    bob_force_walk: NotNegative = 0.1  # random walk of the force on the bob, N/√s
    gust_walk: NotNegative = 0.0  # N/√s, `bob_force_walk` in strong wind, see `estimation.kalman`; 0: the same
    torque_walk: NotNegative = 0.1  # random walk of the torque, N·m/√s
    torque_noise: NotNegative = 0.0  # white noise of the torque, N·m·√s; it is larger than that of any wind
    models_loop: bool = False  # whether the gain is designed with the rate loop and the lag of the rotors
    mass_time: NotNegative = 0.0  # s, time constant of the estimate μ̂ of weight to thrust; 0: μ̂ = 1
    predicts: bool = True  # whether known delays and lags of the loop are predicted through


@settings
class FlatnessGains:
    """Gains of `controllers.flatness`."""

    position_bandwidth: Bandwidth = 2.5  # of a pair of poles
    pendulum_bandwidth: Bandwidth = 7.0  # near the desired pendulum direction
    attitude_bandwidth: Bandwidth = 20.0  # near the desired pendulum direction
    damping: Damping = 0.9  # ζ of all pairs of poles
    vertical_bandwidth: Bandwidth = 6.0  # of height and yaw
    acceleration: Positive = 3.0  # m/s², limit of the bob acceleration that the position error demands
    velocity: Positive = 1.5  # m/s, limit of the velocity that the position error demands
    lean: Angle = 1.1  # limit of the tilt of the thrust
    far_pendulum_bandwidth: Bandwidth = 4.5  # far from the desired pendulum direction
    far_attitude_bandwidth: Bandwidth = 8.0  # far from the desired pendulum direction
    near: Positive = 0.1  # η₀: at η = η₀ each bandwidth is the mean of its near and far values
    estimator: EstimatorGains = EstimatorGains()


@settings
class LqrGains:
    """Gains of `controllers.lqr`: the weights are inverse squares of tolerances."""

    position: Positive = 0.3  # m
    velocity: Positive = 0.6  # m/s
    angle: Positive = 0.5  # rad
    angle_rate: Positive = 3.0  # rad/s
    effort: Positive = 1.0  # share of the range of the action
    reach: Positive = 0.5  # m, limit of the horizontal position error in the feedback
    integral: NotNegative = 0.0  # m·s; 0: no integrators; only `lqi` has them
    integral_limit: NotNegative = 0.5  # m·s
    estimator: EstimatorGains = EstimatorGains()


@settings
class DualModeGains:
    """Gains of `controllers.dual_mode`."""

    far: FlatnessGains = FlatnessGains()  # far from the reference
    near: LqrGains = LqrGains()  # near it; its reach and estimator are not used
    near_error: NotNegative = 0.09  # ε₀, m √s: below ε₀ and α₀ only the law near the reference
    far_error: NotNegative = 0.16  # ε₁, m √s: above ε₁ or α₁ only the law far from it
    near_tilt: NotNegative = 0.15  # α₀, rad
    far_tilt: NotNegative = 0.3  # α₁, rad

    @property
    def estimator(self) -> EstimatorGains:
        """Both laws use the estimates of `far`."""
        return self.far.estimator


@settings
class LqgGains:
    """Gains of `controllers.lqg`."""

    far: FlatnessGains = FlatnessGains()  # far from the reference; its estimator is not used
    effort: Positive = 0.03  # m, the tracking error that counts as much as an action of 1
    wind_time: Positive = 3.0  # s, time constant with which the feedback expects the estimated wind to fade
    yaw: Positive = 0.1  # m, the tracking error that counts as much as a yaw error of 1 rad
    near_error: NotNegative = 0.09  # ε₀, m √s: below ε₀ and α₀ only the law near the reference
    far_error: NotNegative = 0.16  # ε₁, m √s: above ε₁ or α₁ only the law far from it
    near_tilt: NotNegative = 0.15  # α₀, rad
    far_tilt: NotNegative = 0.3  # α₁, rad
    estimator: EstimatorGains = EstimatorGains(models_loop=True)


@settings
class NmpcGains:
    """Gains of `controllers.nmpc`."""

    feedback: LqrGains = LqrGains()  # weights of the cost
    periods: Count = 13  # H, periods of the horizon
    period: Annotated[float, Range(1e-4, 10.0, "s")] = 0.04  # T, period of the horizon
    iterations: Count = 1  # largest number of SQP steps in a control step
    estimator: EstimatorGains = EstimatorGains()


@settings
class SwingUpGains:
    """Gains of `controllers.swing_up`, and the limits of the region in which the balancing controller takes over."""

    damp: Positive = 0.336  # q, m/s, of damping the swing
    lead: NotNegative = 0.0521  # τ, s
    position: NotNegative = 2.65  # k, 1/s²
    velocity: NotNegative = 4.5  # d, 1/s
    lean: Angle = 0.596  # λ_max
    attitude_bandwidth: Bandwidth = 15.0  # of roll and pitch while damping
    vertical_bandwidth: Bandwidth = 3.61  # of height and yaw while damping
    damping: Damping = 0.892  # of both
    # Of the time-varying regulator; set by hand
    regulator: LqrGains = LqrGains(position=0.2, velocity=1.0, angle=1.4, angle_rate=4.0)
    catch: Positive = 0.347  # c
    catch_height: Annotated[float, Range(-1.0, 1.0)] = 0.745  # r_z
    lost_height: Annotated[float, Range(-1.0, 1.0)] = 0.4  # r_z; set by hand
    rest_scale: Positive = 1.02  # factor on the limits of "almost at rest" in `controllers.swing_up`


class Search(NamedTuple):
    """The search that found the gains of a controller."""

    command: str  # the command that repeats the search
    # Mean penalised RMSE over the scenarios of the search, in mm, in episodes that the search did not use. A fall
    # (early termination) counts as 1 m. See `quadpend_train.search.tuning`.
    score: float
    scenarios: Sequence[str] = ("training",)  # scenarios, and sets of scenarios, of the search


KINDS: dict[str, type] = {
    "adrc": AdrcGains,
    "lqr": LqrGains,
    "flatness": FlatnessGains,
    "dual-mode": DualModeGains,
    "lqg": LqgGains,
    "nmpc": NmpcGains,
    "swing-up": SwingUpGains,
}
_NO_GAINS = ("like", "vehicle", "search", "description")  # keys of the tables in the file
_DATA = read_toml(Path(__file__).with_suffix(".toml"))


def _table(group: str, name: str) -> dict[str, Any]:
    own = _DATA[group][name]
    return {**_table(group, own["like"]), **own} if "like" in own else own


def _read(group: str) -> dict[str, Any]:
    """Return the gains of a group by controller; a string in a field is the controller whose gains it takes."""
    out: dict[str, Any] = {}
    for name in _DATA[group]:
        table = {key: value for key, value in _table(group, name).items() if key not in _NO_GAINS}
        kind = KINDS[table.pop("kind")]
        out[name] = kind(**{key: out[value] if isinstance(value, str) else value for key, value in table.items()})
    return out


def _searches(group: str) -> dict[str, Search]:
    return {name: Search(**table["search"]) for name, table in _DATA[group].items() if "search" in table}


# Gains by controller: of the paper's vehicle, of the paper's vehicle with a hanging pendulum (`HANGING_GAINS`), and of
# rigid vehicles with the vehicle for which they were found (`RIGID_GAINS`), and of the hummingbird; see
# `controllers.vehicle_gains.gains_for`.
GAINS, HANGING_GAINS = _read("paper"), _read("hanging")
RIGID_GAINS = {name: (gains, _table("rigid", name)["vehicle"]) for name, gains in _read("rigid").items()}
HUMMINGBIRD_GAINS = _read("hummingbird")
DESCRIPTIONS = {name: table["description"] for name, table in _DATA["paper"].items()}
UNPREDICTED = "-unpredicted"  # end of the names of controllers that do not know the delays and lags of the loop
for _name in ("flatness", "lqr"):
    DESCRIPTIONS[_name + UNPREDICTED] = f"{_name}, without the prediction through known delays and lags"
# The searches; gains without an entry are the paper's, set by hand, or derived from those of another controller.
TUNED, HANGING_TUNED, HUMMINGBIRD_TUNED = (_searches(group) for group in ("paper", "hanging", "hummingbird"))
# Gains of ADRC by the names that its constructor accepts.
ADRC_GAINS: dict[str, AdrcGains] = {
    name.removeprefix("adrc-"): gains for name, gains in GAINS.items() if name.startswith("adrc-")
}
