"""Replay of a flight log: the vehicle flies open loop from states of the log, under the motor commands of the log.

A window begins with the logged position, velocity, attitude and body rate, and with the rotor thrusts that the commands
before it have brought; thrusts do not lag behind measured speeds. All windows are one batch of the plant. The vehicle
has its pole if the log has the pole's direction.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.plants import RigidPlant
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.state import DIRECTION, STATE_SIZE, TORQUE, State
from quadpend_gym.vehicles import Pole, RateLoop, Rotors, Simulation, Vehicle, hover_thrusts, rotors_of
from quadpend_train.flight_logs.log import FlightLog

CHANNELS = {"position": "mm", "velocity": "mm/s", "attitude": "°", "rate": "°/s", "pole": "°"}
SCALES = dict(zip(CHANNELS, (1e3, 1e3, *np.degrees(np.ones(3))), strict=True))
_NO_POLE = Pole(mass=1e-5, length=0.5)  # the lightest one; its weight is 0.1 mN
_LONGEST_STEP = 0.005  # s
_BRUSHED = 2.0  # exponent of the voltage: the speed of a brushed motor is proportional to it
_MOST = 6000  # windows of a log: hours would take all memory
_WARM_UP = 8.0  # lags of the rotors before a window, in which their thrusts forget where they began


@dataclass(frozen=True)
class Thrust:
    """Thrust of a rotor by its motor number u and the voltage V of the battery.

    It is coefficient · ((1 − linear) u² + linear u) · V^exponent · (1 + trim spin), with V in units of `log.NOMINAL`. A
    motor whose speed is proportional to its mean voltage, as a brushed one under PWM, has linear 0 and exponent 2.

    Attributes:
        coefficient: Thrust at u = 1 and the nominal voltage, N; of speeds, N·s²/rad².
        linear: Share of the thrust that is linear in u.
        exponent: Exponent of the voltage.
        trim: Share by which rotors of the spin 1 push more, and those of the spin −1 less.
    """

    coefficient: float
    linear: float = 0.0
    exponent: float = 0.0
    trim: float = 0.0

    def relative(self, numbers: Any, voltage: Any) -> Any:
        """Return the thrust without trim, divided by the coefficient, at motor numbers and voltages."""
        return ((1.0 - self.linear) * numbers**2 + self.linear * numbers) * voltage**self.exponent

    def shape(self, log: FlightLog, spins: Sequence[int]) -> Floats:
        """Return the thrusts of a log divided by the coefficient, shape (n, 4)."""
        found = self.relative(log.motors, log.voltage[:, np.newaxis])
        return np.asarray(found * (1.0 + self.trim * np.array(spins)))


@dataclass(frozen=True)
class Windows:
    """Windows of a log: their first samples, and the number of periods of each.

    Attributes:
        log: The log.
        first: Index of the first sample of each window, shape (w,).
        steps: Periods of a window.
        offset: Added to each logged start: position, velocity, attitude (rotation vector), body rate, x and y of the
            pole's direction, and their derivatives, shape (16,) or (w, 16).
    """

    log: FlightLog
    first: Any
    steps: int
    offset: Any = None

    def beginning(self, share: float) -> "Windows":
        """Return the first part of each window."""
        return replace(self, steps=max(1, round(share * self.steps)))

    @property
    def samples(self) -> Any:
        """Indices of the samples of the windows, shape (steps + 1, w)."""
        return self.first + np.arange(self.steps + 1)[:, np.newaxis]


def windows_of(log: FlightLog, horizon: float, stride: float) -> Windows:
    """Return windows of `horizon` seconds, without a gap, that begin every `stride` seconds; at most `_MOST`."""
    steps, lead = max(1, round(horizon / log.period)), round(0.5 / log.period)
    first = np.arange(lead, len(log) - steps - lead, max(1, round(stride / log.period), -(-len(log) // _MOST)))
    gaps = np.append(0, np.cumsum(~log.valid))
    first = first[gaps[first + steps + 1] == gaps[first]]
    if not len(first):
        length = len(log) * log.period
        raise ValueError(f"{length:.3g} s of the log {log.name!r} have no {horizon + 1.0:g} s without a gap")
    return Windows(log, first, steps)


def without_pole(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose pole weighs nearly nothing."""
    return replace(vehicle, pole=_NO_POLE, pivot=(0.0, 0.0, 0.0))


def fly(windows: Windows, vehicle: Vehicle, thrust: Thrust, delay: float = 0.0) -> Any:
    """Return the motion of a vehicle in all windows, shape (steps + 1, w, 13), or (steps + 1, w, 16) with a pole.

    Position and velocity (world, m and m/s), quaternion (w, x, y, z), body rate (rad/s), and direction of the pole.

    Args:
        windows: The windows.
        vehicle: The vehicle; its pole flies if the log has one.
        thrust: Thrust by the numbers of `FlightLog.motors`.
        delay: Time by which the log of the motion is later than that of the motors, s.
    """
    log, offset, rotors = windows.log, windows.offset, rotors_of(vehicle)
    vehicle = without_pole(vehicle) if log.pole is None else vehicle
    if log.measured:
        rotors = replace(rotors, lag_up=0.0, lag_down=None)
    low, high = rotors.thrust
    damping = float((np.array(vehicle.drag.angular) / np.diag(vehicle.inertia_matrix)).max())  # 1/s
    substeps = int(np.ceil(log.period * max(1.0 / _LONGEST_STEP, 1.01 * damping)))
    slow = replace(vehicle, rotors=rotors, rate_loop=RateLoop(time_constant=1.0))  # it does not act here
    simulation = Simulation(vehicle=slow, interface="rotors", period=log.period, substeps=substeps)
    plant, hover = RigidPlant(simulation), hover_thrusts(slow)
    # The command of a period is the mean thrust in it; thrusts are linear between samples.
    shift, part = divmod(-delay / log.period, 1.0)
    rows = np.arange(len(log)) + int(shift)
    shape = thrust.shape(log, rotors.spins)
    shifted = (shape[(rows + i).clip(0, len(log) - 1)] for i in range(3))
    weights = 0.5 * (1.0 - part) ** 2, 0.5 + part * (1.0 - part), 0.5 * part**2
    mean = sum(weight * each for weight, each in zip(weights, shifted, strict=True))
    thrusts = np.clip(thrust.coefficient * mean, low, high)
    actions = rotor_actions(thrusts, hover, rotors.thrust)

    count = len(windows.first)
    state, memory = np.zeros((count, STATE_SIZE)), np.empty((count, plant.memory_size))
    view = State(state)
    view.position[:], view.velocity[:] = log.position[windows.first], log.velocity[windows.first]
    view.direction[:, 2] = 1.0
    if log.pole is not None:
        state[:, DIRECTION:] = log.pole[windows.first]
        if offset is not None:
            view.direction[:, :2] += offset[..., 12:14]
            view.direction_rate[:, :2] += offset[..., 14:]
        view.direction[:] /= np.linalg.norm(view.direction, axis=1, keepdims=True)
        view.direction_rate[:] -= (view.direction * view.direction_rate).sum(axis=1, keepdims=True) * view.direction
    memory[:, QUATERNION:BODY_RATE] = log.quaternion[windows.first]
    memory[:, BODY_RATE:ROTOR_THRUST] = log.rate[windows.first]
    if offset is not None:
        view.position[:] += offset[..., :3]
        view.velocity[:] += offset[..., 3:6]
        turned = log.rotation[windows.first] * Rotation.from_rotvec(offset[..., 6:9])
        memory[:, QUATERNION:BODY_RATE] = turned.as_quat(scalar_first=True)
        memory[:, BODY_RATE:ROTOR_THRUST] += offset[..., 9:12]
    memory[:, ROTOR_THRUST:] = _thrusts_at(windows.first, thrusts, rotors.lags, log.period)
    parameters = np.tile(simulation.parameters.as_array(), (count, 1))
    out = np.empty((windows.steps + 1, count, 16))
    for step in range(windows.steps + 1):
        out[step] = np.hstack([view.position, view.velocity, memory[:, :ROTOR_THRUST], view.direction])
        if step < windows.steps:
            disturbance, at = np.zeros((count, 9)), windows.first + step
            if log.has_speeds:
                disturbance[:, TORQUE:] = spin_up_torque(memory, thrusts[at], rotors, thrust.coefficient, log.period)
            plant.advance(state, memory, actions[at], disturbance, parameters)
    return out[..., :13] if log.pole is None else out


def rotor_actions(thrusts: Floats, hover: Floats, limits: tuple[float, float]) -> Floats:
    """Return the actions of the interface "rotors" for thrusts (N); `hover`: those of hover, shape (..., 4)."""
    (low, high), gap = limits, thrusts - hover
    return np.asarray(np.where(gap > 0.0, gap / (high - hover), gap / (hover - low)))


def spin_up_torque(memory: Any, wanted: Any, rotors: Rotors, coefficient: float, period: float) -> Any:
    """Return the mean torque on the body over a period from the acceleration of the rotors, world frame, N·m.

    It is J Σ sᵢ ω̇ᵢ about the body's z axis, which the plant leaves out; J is `Rotors.inertia`. Shape (w, 3).

    Args:
        memory: Memories of the plant at the start, shape (w, size).
        wanted: Commanded thrusts, N, shape (w, 4).
        rotors: The rotors.
        coefficient: Thrust per squared speed, N·s²/rad².
        period: The period, s.
    """
    now = memory[:, ROTOR_THRUST:]
    gained = np.sqrt(_after(now, wanted, rotors.lags, period)) - np.sqrt(now)
    torque = rotors.inertia / (np.sqrt(coefficient) * period) * gained @ np.array(rotors.spins)
    w, x, y, z = memory[:, QUATERNION:BODY_RATE].T
    return (torque * np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])).T


def _thrusts_at(first: Any, thrusts: Any, lags: tuple[float, float], period: float) -> Any:
    """Return the thrusts of the rotors at the samples `first`, shape (w, 4), after `_WARM_UP` lags."""
    back = min(int(first[0]), int(np.ceil(_WARM_UP * max(lags) / period)))
    now = thrusts[first - back]
    for step in range(back, 0, -1):
        now = _after(now, thrusts[first - step], lags, period)
    return now


def _after(now: Any, wanted: Any, lags: tuple[float, float], period: float) -> Any:
    """Return the thrusts after a period, with the lags of rise and fall."""
    up, down = (np.exp(-period / lag) if lag > 0.0 else 0.0 for lag in lags)
    return wanted + np.where(wanted > now, up, down) * (now - wanted)


def errors(motion: Any, windows: Windows, steps: Any = slice(None)) -> Any:
    """Return motion minus log: position, velocity, attitude (rotation vector) and body rate, shape (steps + 1, w, 12).

    With a pole, three more: its direction. `steps` selects steps of the windows.
    """
    log, at, motion = windows.log, windows.samples[steps], motion[steps]
    logged, flown = log.quaternion[at], motion[..., 6:10]
    v, w = logged[..., 1:], flown[..., 1:]
    turn = logged[..., :1] * w - flown[..., :1] * v - np.cross(v, w)  # vector part of the rotation from log to motion
    sine, cosine = np.linalg.norm(turn, axis=-1, keepdims=True), (logged * flown).sum(axis=-1, keepdims=True)
    half = np.arctan2(np.copysign(sine, cosine), np.abs(cosine))
    attitude = 2.0 * half / np.maximum(sine, 1e-12) * turn
    linear = motion[..., :6] - np.concatenate([log.position[at], log.velocity[at]], axis=-1)
    pole = [] if log.pole is None else [motion[..., 13:] - log.pole[at, :3]]
    return np.concatenate([linear, attitude, motion[..., 10:13] - log.rate[at], *pole], axis=-1)


def rms(found: Any) -> dict[str, Floats]:
    """Return the root mean square of the length of each error over the windows, SI units, shape (steps + 1,) each."""
    sizes = np.sqrt((found.reshape(*found.shape[:2], -1, 3) ** 2).sum(axis=-1).mean(axis=1))
    return dict(zip(CHANNELS, sizes.T, strict=False))  # without a pole, the last channel is missing


def held(windows: Windows) -> Any:
    """Return the motion with constant velocity and the attitude, body rate and pole of the start, as `fly` does."""
    log, first = windows.log, windows.first
    pole = [] if log.pole is None else [log.pole[first, :3]]
    start = np.hstack([log.position[first], log.velocity[first], log.quaternion[first], log.rate[first], *pole])
    out = np.tile(start, (windows.steps + 1, 1, 1))
    times = log.period * np.arange(windows.steps + 1)
    out[..., :3] += times[:, np.newaxis, np.newaxis] * log.velocity[first]
    return out


def hover_thrust(log: FlightLog, vehicle: Vehicle) -> Thrust:
    """Return the thrust by motor numbers that explains the log's vertical acceleration."""
    gravity, mass = vehicle.gravity, vehicle.mass + (0.0 if log.pole is None else vehicle.pole.mass)
    thrust = Thrust(1.0, exponent=0.0 if log.has_speeds else _BRUSHED)
    lift = thrust.shape(log, rotors_of(vehicle).spins).sum(axis=1)
    if not log.has_position:  # near hover on average
        return replace(thrust, coefficient=float(mass * gravity / lift.mean()))
    up = log.rotation.as_matrix()[:, 2, 2] * lift
    rise = (log.velocity[-1, 2] - log.velocity[0, 2]) / (log.period * (len(log) - 1))
    return replace(thrust, coefficient=float(mass * (gravity + rise) / up.mean()))


def compare(
    log: FlightLog,
    vehicles: dict[str, Vehicle],
    horizon: float = 0.5,
    delay: float = 0.0,
    thrusts: Mapping[str, Thrust] = MappingProxyType({}),
) -> dict[str, dict[str, Floats]]:
    """Return the errors of vehicles, and of constant velocity with held attitude, over the horizon, see `rms`.

    A vehicle that `thrusts` does not name has its `rotors.thrust_coefficient`. If it has none, or the log has no
    speeds, it has the coefficient that explains the log's vertical motion. ``"time"`` has the times in s.
    """
    windows, out = windows_of(log, horizon, 0.05), dict[str, dict[str, Floats]]()
    for name, vehicle in vehicles.items():
        known = rotors_of(vehicle).thrust_coefficient if log.has_speeds else None
        thrust = thrusts.get(name) or (Thrust(known) if known else hover_thrust(log, vehicle))
        out[name] = rms(errors(fly(windows, vehicle, thrust, delay), windows))
    out["held"] = rms(errors(held(windows), windows))
    times = np.asarray(log.period * np.arange(windows.steps + 1), float)
    return {name: {"time": times, **found} for name, found in out.items()}


def table(found: dict[str, dict[str, Floats]]) -> str:
    """Return the errors at five times of the horizon as lines of text; held: constant velocity and attitude."""
    width = max(map(len, found))
    time = found["held"]["time"]
    rows = np.unique(np.linspace(0, len(time) - 1, 6).round().astype(int))[1:]
    lines = [f"{'root mean square at':<{width + 20}}" + "".join(f"{time[row]:>9.2f} s" for row in rows)]
    for channel, unit in CHANNELS.items():
        if channel not in found["held"]:  # no pole flew
            continue
        for name, errors_of in found.items():
            values = "".join(f"{SCALES[channel] * errors_of[channel][row]:>11.1f}" for row in rows)
            lines.append(f"{f'{channel}, {unit}':<20}{name:<{width}}{values}")
    return "\n".join(lines)
