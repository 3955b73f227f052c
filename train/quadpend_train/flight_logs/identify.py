"""Identification of a vehicle from flight logs by output-error fits.

The vehicle flies the windows of the logs open loop (`replay`). A fit minimises the errors of position, attitude and
body rate at several times of a window, each divided by its root mean square in its log at this time, with a loss that
is linear for large errors: gentle and quick flights, early and late errors count alike. The logged start of a window
has errors too: what a small change of the start explains is subtracted from the errors of each window. The velocity
counts too if it is logged: in NanoDrone's flights this predicts flights of other kinds better (docs/real-flights.md).
Mass, gravity and the geometry of the rotors are known. From motions and motor numbers follow:

| name                   | what the log shows                                                                        |
|------------------------|-------------------------------------------------------------------------------------------|
| `thrust_coefficient`   | thrust per squared motor number: the mass times an acceleration                           |
| `thrust_linear`        | share of the thrust that is linear in a command, see `replay.Thrust`                      |
| `voltage_exponent`     | thrust against the voltage of the battery                                                 |
| `inertia_roll`, `_pitch` | torque, which is arm times thrust, per angular acceleration                               |
| `torque_per_thrust`    | only κ/I_z: the inertia of yaw is assumed, see below                                      |
| `yaw_trim`             | share by which the rotors of one sense push more, from the trim of the thrusts            |
| `rotor_inertia`        | only J/I_z: the body turns against rotors that speed up                                   |
| `lag`, `delay`         | first-order lag of the thrusts, and how much later than the motors the motion is logged   |
| `drag_x`, `_y`, `_z`   | drag per velocity along the body axes                                                     |
| `drag_height`          | torque of this drag per force: where it acts above the centre of mass                     |
| `angular_drag`, `_yaw` | torque against the body rate, about x and y, and about z                                  |
| `centre_x`, `centre_y` | centre of mass in the frame of the rotors' positions, from the trim of the thrusts        |
| `pole_length`          | only λ = l + J/(m l), against the acceleration of the pivot: J/(m l²) is assumed          |
| `pole_drag_area`       | drag of the pole: its mass times an acceleration                                          |

The last two need the direction of the pole, and then its mass and pivot must be right. Without it, no pole flies.
Batteries are not always in the same place, and rotors wear: in each log the thrusts of the rotors get the factors that
bring their mean shares to the mean of the logs (`FlightLog.trimmed`).
The inertia of yaw keeps its ratio to the sum of the two others, which the start vehicle has. Where no body has such
moments, `possible` maps them smoothly onto those of one.

Intervals: 95 %, from the covariance of blocks of windows, H⁻¹ (Σ gᵦ gᵦᵀ) H⁻¹ with the gradient gᵦ of each block, the
Hessian H = Jᵀ diag(ρ″) J of the loss ρ, and Student's t. Errors in neighbouring windows depend on each other, which H⁻¹
alone leaves out. White noise of the motor numbers biases the fit: as much noise again, added to the log, moves the
minimum by about this bias, in one Newton step. The bias is subtracted, and counts as a deviation. If a
regression on the motors explains less than 40 % of the angular accelerations about x and y, as in gentle flight, in the
mean over the logs, inertia, lag, delay and torques of the drag count as not identified.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.stats import t as student

from quadpend_gym.core.arrays import Floats
from quadpend_gym.vehicles import Drag, Pole, Vehicle, rotors_of
from quadpend_gym.vehicles.vehicle import FASTEST_LOOP
from quadpend_train.flight_logs.log import FlightLog, rate_of_attitude, smoothed_derivative
from quadpend_train.flight_logs.replay import Thrust, Windows, errors, fly, hover_thrust, windows_of, without_pole

TRAINING = 0.7  # share of each log for the fit; the rest is held out
_HORIZON, _STRIDE, _TIMES = 0.4, 0.1, 20  # s, s; times in a window at which errors count
_BLOCKS = 30
_POLE_DRAG = 0.2  # m²/kg: drag area of a carbon tube per mass, where the fit begins
UNIDENTIFIED, _BLIND = 0.2, 1.0  # relative standard deviations; beyond the second, the value of the start is better
_PASSES = (0.3, 1.0)  # share of each window in the first and in the second fit: far starts diverge in long windows
_EARLY = 0.3  # of the root mean square over a window: least scale of errors, since starts explain the earliest ones
_THINNEST = 0.02  # of the sum: least second moment of mass along an axis
_IGNORED = 1e9  # scale of errors that do not count
_GENTLE = 0.4  # share of the angular accelerations that motors explain, below which neither order nor inertia shows
_STEADY = 0.65  # least `steadiness` of single readings; NanoBench's quick flights have 0.87 to 0.97
_FAR, _FARTHER = 3.0, 6.0  # times a quantity of the start vehicle: doubtful; of drags and lags, which are less known
_LESS_KNOWN = ("lag", "drag", "pole_drag")
_SLOW = 0.1  # s: half width of the means of body rates that are compared with those of the attitude
_MOVING = 0.1  # rad/s, m/s: standard deviation of motion that is no noise
_STILL = 0.3  # correlation of `falling` below which noise hides the pole's motion
_BY_TURNS = ("inertia_roll", "inertia_pitch", "lag", "delay", "drag_height", "angular_drag")
_STEP = 1e-4  # of forward differences, as a share of a quantity's size


@dataclass(frozen=True)
class Quantity:
    """What a fit varies: unit, bounds and size as multiples of what `_sizes` says, and the manoeuvre that shows it."""

    unit: str
    low: float
    high: float
    manoeuvre: str


_SPEED, _TURN = "fast straight flight to all sides", "quick rolls and pitches to both sides"
QUANTITIES = {
    "thrust_coefficient": Quantity("N per squared motor number", 0.3, 3.0, "climbs and descents"),
    "thrust_linear": Quantity("of the thrust", 0.0, 1.0, "climbs and descents"),
    "voltage_exponent": Quantity("", 0.0, 4.0, "until the battery is empty"),
    "torque_per_thrust": Quantity("m", 0.1, 10.0, "yaw steps"),
    "yaw_trim": Quantity("of the thrust", -0.3, 0.3, "hover"),
    "rotor_inertia": Quantity("kg·m²", 0.0, 10.0, "yaw steps"),
    "inertia_roll": Quantity("kg·m²", 0.1, 10.0, "quick rolls to both sides"),
    "inertia_pitch": Quantity("kg·m²", 0.1, 10.0, "quick pitches to both sides"),
    "lag": Quantity("s", 0.02, 5.0, _TURN),
    "delay": Quantity("s", -5.0, 5.0, _TURN),
    "drag_x": Quantity("N·s/m", 0.0, 20.0, _SPEED),
    "drag_y": Quantity("N·s/m", 0.0, 20.0, _SPEED),
    "drag_z": Quantity("N·s/m", 0.0, 20.0, "fast climbs and descents"),
    "drag_height": Quantity("m", -6.0, 6.0, _SPEED),
    "angular_drag": Quantity("N·m·s/rad", 0.0, 50.0, _TURN),
    "angular_drag_yaw": Quantity("N·m·s/rad", 0.0, 50.0, "long turns about the vertical"),
    "centre_x": Quantity("m", -0.5, 0.5, "hover"),
    "centre_y": Quantity("m", -0.5, 0.5, "hover"),
    "pole_length": Quantity("m", 0.3, 3.0, "swings of the pole"),
    "pole_drag_area": Quantity("m²", 0.0, 20.0, _SPEED),
}
POLE = ("pole_length", "pole_drag_area")  # only from logs of the pole's direction
COMMANDS = ("thrust_linear", "voltage_exponent")  # only from commands
_FROM_ZERO = ("thrust_linear", "yaw_trim", "delay", "drag_height", "centre_x", "centre_y")  # fits begin with zero
_MAY_BE_ZERO = (*_FROM_ZERO, "lag")  # their size is the scale of the precision


@dataclass(frozen=True)
class Estimate:
    """A quantity: value, 95 % interval, whether the log shows it, and whether the log says nothing about it."""

    name: str
    value: float
    interval: tuple[float, float]
    identified: bool
    blind: bool


@dataclass(frozen=True)
class Found:
    """What a fit to windows of logs found.

    Attributes:
        vehicle: The vehicle; quantities about which the logs say nothing have the values of the start vehicle.
        thrust: Thrust by the motor numbers.
        delay: Time by which the motion is logged later than the motors, s.
        estimates: All quantities by name.
        fitted, held_out: The logs for the fit and for the test.
        gentle: Whether the motors explain too little of the turning to show their order and the inertia.
    """

    vehicle: Vehicle
    thrust: Thrust
    delay: float
    estimates: dict[str, Estimate]
    fitted: Sequence[FlightLog]
    held_out: Sequence[FlightLog]
    gentle: bool

    def table(self) -> str:
        """Return the quantities with their 95 % intervals as lines of text."""
        lines = [f"{'quantity':<20}{'value':>12}{'95 % interval':>26}  unit"]
        for name, found in self.estimates.items():
            low, high = found.interval
            shown = f"{low:.4g} to {high:.4g}" if found.identified else "not identified"
            lines.append(f"{name:<20}{found.value:>12.4g}{shown:>26}  {QUANTITIES[name].unit}")
        return "\n".join(lines)

    def sentences(self) -> list[str]:
        """Return what the logs do not show, with the manoeuvre that would, and which logs have too few samples."""
        hidden, missing = [name for name, each in self.estimates.items() if not each.identified], unseen(self.fitted[0])
        order = ["the order of the motors could not be checked: the flight is gentle"] if self.gentle else []
        return [
            *order,
            *(f"{name} is not identified; {missing.get(name, f'fly {QUANTITIES[name].manoeuvre}')}" for name in hidden),
            *(
                f"the motors of {log.name} change much between its rows: inertia and lag are wrong unless the numbers"
                " are means over a row, as --blackbox makes them"
                for log in self.fitted
                if not self.gentle and steadiness(log, self.vehicle) < _STEADY
            ),
        ]


def unseen(log: FlightLog) -> dict[str, str]:
    """Return the quantities that no manoeuvre shows in this log, and what to log instead."""
    out = {"lag": "log the commanded speeds"} if log.measured else {}
    if not log.has_speeds:
        out["rotor_inertia"] = "log the speeds of the rotors"
    if log.is_command and not np.ptp(log.voltage):
        out["voltage_exponent"] = "log the voltage of the battery"
    return out


def identify(
    logs: Sequence[FlightLog], start: Vehicle, training: float = TRAINING, tests: Sequence[FlightLog] = ()
) -> Found:
    """Identify a vehicle from logs of flights without a pole, or with its direction.

    Args:
        logs: Logs of one vehicle with the same motor numbers.
        start: Vehicle with the true masses and geometry; everything else is where the fit begins.
        training: Share of each log for the fit; the rest is held out. With `tests`, the fit has all.
        tests: Logs that are held out.
    """
    for log in (*logs, *tests):
        check_log(log, start)
    share = 1.0 if tests else training
    trim = np.mean([log.trim for log in logs], axis=0)
    logs, tests = ([log.trimmed(trim) for log in each] for each in (logs, tests))
    fitted = [log.part(0.0, share) for log in logs]
    held_out = tests or ([log.part(share, 1.0) for log in logs] if share < 1.0 else [])
    for log in held_out:
        windows_of(log, 0.5, 0.05)  # as `compare` does: a log that is too short is refused before the fit
    return replace(fit([windows_of(log, _HORIZON, _STRIDE) for log in fitted], start), held_out=held_out)


def fit(windows: Sequence[Windows], start: Vehicle) -> Found:
    """Return the vehicle that flies the windows best, beginning with `start`."""
    logs = [each.log for each in windows]
    model = _Model.of(logs, start)
    moved = [falling(log, start) > _STILL for log in logs if log.pole is not None]
    missing = {name: model.known[name] for name in (*unseen(logs[0]), *(() if any(moved) else POLE))}
    absent = (*(() if model.has_pole else POLE), *(() if logs[0].is_command else COMMANDS))
    quantities = [name for name in QUANTITIES if name not in absent]
    values, names = model.begin | missing, [name for name in quantities if name not in missing]
    for share in _PASSES:
        found = _solved(model, [each.beginning(share) for each in windows], values, names)
        values = found.values
    if model.has_pole:  # noise of the logged direction biases the length, since its errors in the starts grow
        found = _solved(model, found.with_best_poles(), values, names)
    estimates = found.estimates()
    if hidden := [name for name, each in estimates.items() if each.blind and name != "delay"]:
        fixed = {name: model.known[name] for name in hidden}  # again, with what the log does not show as in the start
        found = found.solved({**found.values, **fixed}, [name for name in names if name not in hidden])
        estimates |= found.estimates()
    values = found.values
    nothing = {name: Estimate(name, value, (-np.inf, np.inf), False, True) for name, value in missing.items()}
    estimates = {name: (estimates | nothing)[name] for name in quantities}
    shares = [regression(log, start)[0] for log in logs]
    gentle = bool(np.average(shares, weights=[len(log) for log in logs]) < _GENTLE)
    if gentle:
        estimates |= {name: replace(estimates[name], identified=False) for name in _BY_TURNS}
    values |= {name: found.value for name, found in estimates.items() if not found.blind}
    vehicle, thrust = replace(model.vehicle(values), name="identified"), model.thrust(values)
    if not model.has_pole:
        vehicle = replace(vehicle, pole=start.pole, pivot=start.pivot)
    low, high = rotors_of(start).thrust  # what was not flown stays
    flown = [thrust.coefficient * thrust.shape(log, rotors_of(start).spins) for log in logs]
    limits = min(low, *(float(each.min()) for each in flown)), max(high, *(float(each.max()) for each in flown))
    vehicle = replace(vehicle, rotors=replace(rotors_of(vehicle), thrust=limits))
    return Found(vehicle, thrust, values["delay"], estimates, logs, [], gentle)


def doubts_of(found: Found, start: Vehicle) -> list[str]:
    """Return sentences about the quantities that are far from those of the start vehicle."""
    before, after = _numbers(start), _numbers(found.vehicle)
    ratios = {name: max(after[name] / old, 1e-9) for name, old in before.items() if old}
    return [
        f"{name} is {ratio:.2g} times that of {start.name}; check its mass, positions and units, or fly quicker:"
        " gentle flights under control show too much inertia"
        for name, ratio in ratios.items()
        if abs(np.log(ratio)) > np.log(_FARTHER if name.startswith(_LESS_KNOWN) else _FAR)
    ]


def _numbers(vehicle: Vehicle) -> dict[str, float]:
    """Return what a fit changes of a vehicle, and what not only a log knows."""
    rotors, (roll, pitch, _) = rotors_of(vehicle), np.diag(vehicle.inertia_matrix).tolist()
    return {
        "inertia_roll": roll,
        "inertia_pitch": pitch,
        "thrust_coefficient": rotors.thrust_coefficient or 0.0,
        "torque_per_thrust": rotors.torque_per_thrust,
        "lag": rotors.lag_up,
        **dict(zip(("drag_x", "drag_y", "drag_z"), vehicle.drag.rotor, strict=True)),
        "pole_length": vehicle.pole.length,
        "pole_drag_area": vehicle.pole.drag_area,
    }


def possible(roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
    """Return the principal moments of inertia of a body, which are these if a body has them.

    Its second moments of mass along x, y and z, (−I_x + I_y + I_z)/2 and so on, are positive: small and negative ones
    become small positive ones, in a map with a continuous derivative.
    """
    half = 0.5 * (roll + pitch + yaw)
    least = _THINNEST * half
    x, y, z = (
        a if (a := half - each) > least else least * float(np.exp(a / least - 1.0)) for each in (roll, pitch, yaw)
    )
    return y + z, x + z, x + y


@dataclass(frozen=True)
class _Model:
    """Vehicles by the values of the quantities, and sizes, first and known values of these by name."""

    base: Vehicle
    has_pole: bool
    has_speeds: bool
    highest: float  # thrust above all that a fit tries, N
    sizes: dict[str, float]
    begin: dict[str, float]
    known: dict[str, float]  # those of the start vehicle

    @classmethod
    def of(cls, logs: Sequence[FlightLog], start: Vehicle) -> "_Model":
        """Return the model for logs of a vehicle like `start`."""
        has_pole, has_speeds = any(log.pole is not None for log in logs), logs[0].has_speeds
        rotors, mass, pole, drag = rotors_of(start), start.mass, start.pole, start.drag
        arm = float(np.abs(np.array(rotors.positions)[:, :2]).max())
        hover = [hover_thrust(log, start) for log in logs]
        coefficient = float(np.mean([each.coefficient for each in hover]))
        roll, pitch, _ = np.diag(start.inertia_matrix).tolist()
        lag = 0.5 * sum(rotors.lags)
        sizes = {
            "thrust_coefficient": coefficient,
            "thrust_linear": 1.0,
            "voltage_exponent": 1.0,
            "yaw_trim": 1.0,
            "torque_per_thrust": rotors.torque_per_thrust,
            "rotor_inertia": 0.002 * roll,
            "inertia_roll": roll,
            "inertia_pitch": pitch,
            "lag": max(lag, 0.02),
            "delay": 0.02,
            **dict.fromkeys(("drag_x", "drag_y", "drag_z"), 0.2 * mass),
            "drag_height": arm,
            **dict.fromkeys(("angular_drag", "angular_drag_yaw"), roll),
            **dict.fromkeys(("centre_x", "centre_y"), 0.1 * arm),
            "pole_length": pole.length,
            "pole_drag_area": _POLE_DRAG * pole.mass,
        }
        begin = {name: 0.0 if name in _FROM_ZERO else size for name, size in sizes.items()}
        begin["voltage_exponent"] = hover[0].exponent
        known = dict(zip(("drag_x", "drag_y", "drag_z"), drag.rotor, strict=True)) | {
            "thrust_coefficient": (rotors.thrust_coefficient if has_speeds else None) or coefficient,
            "rotor_inertia": rotors.inertia,
            "lag": max(lag, 1e-4),
            "drag_height": drag.height,
            "angular_drag": drag.angular[0],
            "angular_drag_yaw": drag.angular[2],
            "pole_drag_area": pole.drag_area,
        }
        shapes = [hover[0].shape(log, rotors.spins).max() + float(log.is_command) for log in logs]
        highest = max(rotors.thrust[1], 2.0 * QUANTITIES["thrust_coefficient"].high * coefficient * max(shapes))
        base = start if has_pole else without_pole(start)
        return cls(base, has_pole, has_speeds, highest, sizes, begin, begin | known)

    def thrust(self, v: dict[str, float]) -> Thrust:
        """Return the thrust with these values."""
        return Thrust(v["thrust_coefficient"], v["thrust_linear"], v["voltage_exponent"], v["yaw_trim"])

    def vehicle(self, v: dict[str, float]) -> Vehicle:
        """Return the vehicle with these values; without a pole in the logs, with a nearly weightless one."""
        base, rotors = self.base, rotors_of(self.base)
        roll, pitch, yaw = np.diag(base.inertia_matrix).tolist()
        ratio = yaw / (roll + pitch)
        roll, pitch = v["inertia_roll"], v["inertia_pitch"]
        positions: Any = np.array(rotors.positions) - [v["centre_x"], v["centre_y"], 0.0]
        return replace(
            base,
            pole=stretched(base.pole, v["pole_length"], v["pole_drag_area"]) if self.has_pole else base.pole,
            inertia=possible(roll, pitch, ratio * (roll + pitch)),
            rotors=replace(
                rotors,
                positions=positions,
                torque_per_thrust=v["torque_per_thrust"],
                lag_up=v["lag"],
                lag_down=None,
                thrust=(0.0, self.highest),
                inertia=v["rotor_inertia"] if self.has_speeds else rotors.inertia,
                thrust_coefficient=v["thrust_coefficient"] if self.has_speeds else rotors.thrust_coefficient,
            ),
            drag=Drag(
                rotor=(v["drag_x"], v["drag_y"], v["drag_z"]),
                angular=(v["angular_drag"], v["angular_drag"], v["angular_drag_yaw"]),
                height=v["drag_height"],
            ),
            rate_loop=replace(base.rate_loop, time_constant=max(base.rate_loop.time_constant, FASTEST_LOOP * v["lag"])),
        )

    def errors(self, values: dict[str, float], windows: Sequence[Windows], offset: Any = None) -> Floats:
        """Return the errors at the times that count, shape (times, w, c); c is 12, or 15 with a pole."""
        vehicle, thrust, delay = self.vehicle(values), self.thrust(values), values["delay"]
        if offset is not None:
            windows = [replace(w, offset=offset if w.offset is None else offset + w.offset) for w in windows]
        at = np.unique(np.linspace(0, windows[0].steps, _TIMES + 1).round().astype(int))
        found = [errors(fly(each, vehicle, thrust, delay), each, at) for each in windows]
        channels = max(each.shape[2] for each in found)  # a log without a pole has no errors of it
        return np.concatenate([np.pad(each, ((0, 0), (0, 0), (0, channels - each.shape[2]))) for each in found], axis=1)


@dataclass(frozen=True)
class _Weights:
    """How much errors count, and what starts of the windows explain of them, from the values where a fit begins.

    Attributes:
        scales: Root mean square of the errors over windows of a log and axes, by which they are divided, shape
            (times, w, c).
        slopes: Of the scaled errors by the starts of the windows, of norm 1, shape (w, 12 or 16, c times).
        norms: By which the slopes were divided, shape (w, 12 or 16).
        gains: From errors to the starts that explain them best, shape (w, 12 or 16, c times).
    """

    scales: Floats
    slopes: Floats
    norms: Floats
    gains: Floats

    def starts(self, found: Floats) -> Floats:
        """Return the starts that explain errors best, shape (w, 12 or 16)."""
        return np.asarray(np.einsum("wsn,wn->ws", self.gains, _by_window(found / self.scales)))

    def __call__(self, found: Floats) -> Floats:
        """Return scaled errors without what the starts of the windows explain, shape (times, w, c)."""
        times, count, _ = found.shape
        rest = _by_window(found / self.scales) - np.einsum("wsn,ws->wn", self.slopes, self.starts(found))
        return np.ascontiguousarray(np.swapaxes(rest.reshape(count, times, -1), 0, 1))


def _by_window(found: Floats) -> Floats:
    """Return errors of shape (times, w, c) with the shape (w, c times)."""
    return np.swapaxes(found, 0, 1).reshape(found.shape[1], -1)


def _weights(model: _Model, windows: Sequence[Windows], values: dict[str, float]) -> _Weights:
    here, units = model.errors(values, windows, np.zeros(16)), np.eye(16)[: 16 if model.has_pole else 12]
    moved = (model.errors(values, windows, _STEP * unit) - here for unit in units)
    by_start = np.stack([np.swapaxes(each, 0, 1) for each in moved], axis=1) / _STEP
    counts, rest = np.cumsum([len(each.first) for each in windows])[:-1], here
    for _ in range(2):  # the second time without what the starts explain
        scales = np.concatenate(
            [_scales(part, each.log) for part, each in zip(np.split(rest, counts, axis=1), windows, strict=True)],
            axis=1,
        )
        slopes = (by_start / np.swapaxes(scales, 0, 1)[:, np.newaxis]).reshape(*by_start.shape[:2], -1)
        norms = np.maximum(np.linalg.norm(slopes, axis=2, keepdims=True), 1e-6)
        slopes /= norms
        gains = np.linalg.solve(slopes @ np.swapaxes(slopes, 1, 2) + 1e-9 * np.eye(len(units)), slopes)
        weights = _Weights(scales, slopes, norms[..., 0], gains)
        rest = weights(here) * scales
    return weights


def _scales(found: Floats, log: FlightLog) -> Floats:
    """Return the scales of the errors in the windows of a log, shape (times, w, c)."""
    squares = (found.reshape(*found.shape[:2], -1, 3) ** 2).mean(axis=(1, 3))
    sizes = np.sqrt(np.maximum(squares, _EARLY**2 * squares.mean(axis=0)))
    if not log.has_velocity:
        sizes[:, 1] = _IGNORED
    if not log.has_position:
        sizes[:, 0] = _IGNORED
    return np.broadcast_to(np.repeat(np.maximum(sizes, 1e-9), 3, axis=1)[:, np.newaxis], found.shape)


def _solved(model: _Model, windows: Sequence[Windows], values: dict[str, float], names: Sequence[str]) -> "_Fit":
    """Return the values of the named quantities that minimise the loss of the errors, beginning with these."""
    return _Fit(model, windows, _weights(model, windows, values), values, names).solved(values, names)


@dataclass(frozen=True)
class _Fit:
    """A fit of the named quantities."""

    model: _Model
    windows: Sequence[Windows]
    weights: _Weights
    values: dict[str, float]
    names: Sequence[str]  # of the quantities that it varied

    def errors(self, values: dict[str, float]) -> Floats:
        """Return the weighted errors, shape (times, w, c)."""
        return self.weights(self.model.errors(values, self.windows))

    def jacobian(self, values: dict[str, float]) -> Floats:
        """Return the derivatives of the errors by quantities in units of their sizes, shape (times, w, c, k)."""
        here, sizes = self.errors(values), self.model.sizes
        moved = (self.errors({**values, name: values[name] + _STEP * sizes[name]}) for name in self.names)
        return np.stack([(there - here) / _STEP for there in moved], axis=-1)

    def solved(self, values: dict[str, float], names: Sequence[str]) -> "_Fit":
        """Return the fit of the named quantities with the same weights, beginning with these values."""
        again, sizes = replace(self, names=names), self.model.sizes

        def full(x: Any) -> dict[str, float]:
            return values | {name: float(a) * sizes[name] for name, a in zip(names, x, strict=True)}

        def function(x: Any) -> Any:
            return again.errors(full(x)).ravel()

        def slopes(x: Any) -> Any:
            return again.jacobian(full(x)).reshape(-1, len(names))

        low, high = np.array([(QUANTITIES[name].low, QUANTITIES[name].high) for name in names]).T
        found = least_squares(
            function,
            np.clip([values[name] / sizes[name] for name in names], low + 1e-6, high - 1e-6),
            slopes,
            bounds=(low, high),
            loss="soft_l1",
            xtol=1e-4,
            ftol=1e-5,
            max_nfev=30,
        )
        return replace(again, values=full(found.x))

    def with_best_poles(self) -> list[Windows]:
        """Return the windows with the pole starting where their errors are the smallest."""
        starts = -self.weights.starts(self.model.errors(self.values, self.windows)) / self.weights.norms
        starts[:, :12] = 0.0  # the body's starts stay
        counts = np.cumsum([len(each.first) for each in self.windows])
        parts = np.split(starts, counts[:-1])
        return [replace(each, offset=part) for each, part in zip(self.windows, parts, strict=True)]

    def estimates(self) -> dict[str, Estimate]:
        """Return the quantities with their deviations and intervals."""
        values, names = self.values, self.names
        found, slopes = self.errors(values), self.jacobian(values)
        weight = (1.0 + found**2) ** -0.5  # of the loss
        information = np.einsum("twci,twcj,twc->ij", slopes, slopes, weight**3)  # ρ″ = weight³
        inverse = np.linalg.inv(information + 1e-9 * np.eye(len(names)))  # what nothing shows gets a huge variance
        gradients = np.einsum("twci,twc->wi", slopes, weight * found)
        count = min(_BLOCKS, len(gradients))
        blocks = np.array([part.sum(axis=0) for part in np.array_split(gradients, count)])
        spread = inverse @ (blocks.T @ blocks) @ inverse * count / (count - 1.0)
        fisher = np.diag(inverse) * np.mean(weight * found**2)
        biases = inverse @ (gradients.sum(axis=0) - self.noisy_gradient())
        deviations = np.sqrt(np.maximum(np.diag(spread), fisher) + biases**2)
        reach, out = float(student.ppf(0.975, count - 1)), {}
        for name, deviation, bias in zip(names, deviations.tolist(), biases.tolist(), strict=True):
            size, quantity = self.model.sizes[name], QUANTITIES[name]
            low, high = quantity.low * size, quantity.high * size
            value, d = min(max(values[name] - bias * size, low), high), deviation * size
            at_bound = name != "lag" and not low * 1.01 < value < high * 0.99
            share = d / max(abs(value), size if name in _MAY_BE_ZERO else 1e-9 * size)
            interval = value - reach * d, value + reach * d
            out[name] = Estimate(name, value, interval, share < UNIDENTIFIED and not at_bound, share > _BLIND)
        return out

    def noisy_gradient(self) -> Floats:
        """Return the gradient of the loss in units of the sizes with more noise of the motors, as much as they have.

        It is the mean of noise and its negative, in which what is linear in the noise vanishes.
        """
        random, out = np.random.default_rng(0), np.zeros(len(self.names))
        logs = [each.log for each in self.windows]
        noise = [motor_noise(log) * random.standard_normal(log.motors.shape) for log in logs]
        for sign in (1.0, -1.0):
            noisy = [replace(log, motors=log.motors + sign * a) for log, a in zip(logs, noise, strict=True)]
            with_noise = [replace(each, log=log) for each, log in zip(self.windows, noisy, strict=True)]
            other = replace(self, windows=with_noise)
            found, slopes = other.errors(self.values), other.jacobian(self.values)
            out += 0.5 * np.einsum("twci,twc->i", slopes, found * (1.0 + found**2) ** -0.5)
        return out


def stretched(pole: Pole, length: float, drag_area: float) -> Pole:
    """Return a pole with another length and drag area, the same mass and the same J/(m l²)."""
    stretch = length / pole.length
    extent = None if pole.extent is None else stretch * pole.extent
    return replace(pole, length=length, inertia=stretch**2 * pole.inertia, drag_area=drag_area, extent=extent)


def motor_noise(log: FlightLog) -> float:
    """Return the standard deviation of white noise of the motor numbers, from their fourth differences."""
    return float(1.4826 * np.median(np.abs(np.diff(log.motors, 4, axis=0))) / np.sqrt(70.0))


def regression(log: FlightLog, vehicle: Vehicle) -> tuple[float, Any]:
    """Return the share of the angular accelerations about x and y that the motors explain, and its slopes.

    The slopes are those by the squared motor numbers, shape (2, 4), after the delay that explains most: at most the
    rotors' lag and 20 ms. Yaw is left out: in a controlled flight its regression is not reliable.
    """
    half, latest = max(1, round(0.05 / log.period)), (0.5 * sum(rotors_of(vehicle).lags) + 0.02) / log.period
    squares = savgol_filter(log.motors**2, 2 * half + 1, 2, axis=0)
    turning, found = smoothed_derivative(log.rate[:, :2], log.period), list[tuple[float, Any]]()
    for late in np.unique(np.linspace(0.0, latest, 8).round().astype(int)).tolist():
        kept = log.valid[: len(log) - late] & log.valid[late:]
        before, after = squares[: len(log) - late][kept], turning[late:][kept]
        before, after = before - before.mean(axis=0), after - after.mean(axis=0)
        slopes = np.linalg.lstsq(before, after, rcond=None)[0]
        found.append((1.0 - ((after - before @ slopes) ** 2).sum() / max((after**2).sum(), 1e-9), slopes.T))
    return max(found, key=lambda each: each[0])


def steadiness(log: FlightLog, vehicle: Vehicle) -> float:
    """Return the correlation of the motors' torque about x or y with that of the next sample, the smaller one."""
    torques = log.motors**2 @ np.array(rotors_of(vehicle).positions)[:, :2]
    kept = log.valid[1:] & log.valid[:-1]
    pairs = zip(torques[:-1][kept].T, torques[1:][kept].T, strict=True)
    return min(float(np.corrcoef(*pair)[0, 1]) if all(map(np.ptp, pair)) else 1.0 for pair in pairs)


def falling(log: FlightLog, vehicle: Vehicle) -> float:
    """Return the correlation of the pole's angular acceleration with the one of a pole on this pivot."""
    assert log.pole is not None
    direction, weight = log.pole[:, :3], np.array([0.0, 0.0, vehicle.gravity])
    expected = np.cross(direction, -weight - smoothed_derivative(log.velocity, log.period)).ravel()
    turning = np.cross(direction, smoothed_derivative(log.pole[:, 3:], log.period)).ravel()
    return float(np.corrcoef(expected, turning)[0, 1])


def check_motion(log: FlightLog) -> None:
    """Refuse a log whose body rates are not those of its attitude, or whose velocities not those of its position."""

    def without_noise(*numbers: Floats) -> list[Floats]:
        width = 2 * max(1, round(_SLOW / log.period)) + 1  # motion capture shows no quick turns
        return [savgol_filter(each, width, 1, axis=0)[log.valid] for each in numbers]

    rate, turned = without_noise(log.rate, rate_of_attitude(log.rotation, log.period))
    axes = np.flatnonzero(rate.std(axis=0) > _MOVING)
    ratio = rate.std() / max(turned.std(), 1e-9)
    if any(np.corrcoef(rate[:, axis], turned[:, axis])[0, 1] < 0.5 for axis in axes) or (len(axes) and ratio > 2.0):
        raise ValueError(
            f"the log {log.name!r} has body rates that are not those of its attitude ({ratio:.3g} times as large):"
            " check the order of the quaternion (w, x, y, z; body to world), the frame, and rate_unit"
        )
    velocity, moved = without_noise(log.velocity, smoothed_derivative(log.position, log.period))
    if moved.std() > _MOVING and (velocity - moved).std() > 0.5 * moved.std():
        raise ValueError(
            f"the log {log.name!r} has velocities that are not those of its position"
            f" ({velocity.std() / moved.std():.3g} times as large): they must be in m/s and in the world frame"
        )


def check_log(log: FlightLog, vehicle: Vehicle) -> None:
    """Refuse a log whose attitude and body rate contradict each other, whose pole falls up, or with mixed-up motors."""
    if log.pole is not None and falling(log, vehicle) < -0.5:
        raise ValueError(
            f"the log {log.name!r} has a pole that falls upwards: check that its direction is in the world frame and"
            " leads from the pivot to its centre of mass"
        )
    check_motion(log)
    if (log.rate[log.valid].std(axis=0) < _MOVING).all() or not np.ptp(log.motors):
        return  # nothing turns the body
    explained, slopes = regression(log, vehicle)
    if explained < _GENTLE:
        return
    x, y, _ = np.array(rotors_of(vehicle).positions).T
    expected = np.array([y, -x])

    def score(order: Sequence[int]) -> float:
        return float(sum(np.corrcoef(a[list(order)], b)[0, 1] for a, b in zip(slopes, expected, strict=True)))

    best = max(permutations(range(4)), key=score)
    if score(best) > score(range(4)) + 0.5:
        raise ValueError(
            f"the log {log.name!r} has its motors in another order than the vehicle has its rotors: rotors 1 to 4 turn"
            f" the body like columns {', '.join(str(i + 1) for i in best)} of the present list of motors"
        )
