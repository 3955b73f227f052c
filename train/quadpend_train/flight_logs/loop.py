"""Latency and rate loop of a vehicle from a log of `quadpend fly`.

A row has a sample with the time of its exposure, and the command that answered it. The command acts a latency after the
exposure. Then the body rate follows by equation (1) of `quadpend_gym.physics.rotors`, with the rotors' lag of the
vehicle. The fit compares by how much the body turned about x and y between two samples. Yaw is left out: most rate
loops are slower there. What turns the body slowly, such as wind and drag, is subtracted as a parabola.

Slow changes of the commands show the sum of latency and time constant only: both make the motion later. Their split
follows from quick changes. A second fit, to quicker ones alone, tests it: its difference counts as a deviation.
"""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.signal import lfilter, savgol_filter
from scipy.spatial.transform import Rotation

from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.rotors import rate_loop_gains
from quadpend_gym.vehicles.vehicle import FASTEST_LOOP
from quadpend_train.flight_logs.log import LONGEST_GAP, NORM, Columns, numeric

_STEP = 0.001  # s
_SETTLED = 0.4  # s, after which the begin is forgotten
_LEAST = 200  # samples
_SMOOTHING = 0.04  # s: half width of the parabola that takes noise from the differences
_SLOW = (0.25, 0.15)  # s: of the parabola that is slow motion, in the fit and in its test
_BLOCKS = 30
_QUATERNION, _RATES = ["qw", "qx", "qy", "qz"], ["rate_x", "rate_y"]
_SLOWEST = 0.3  # s
_EXPLAINED = 0.6  # least share of the quick turns that commands explain
_KNOWN = 0.04  # of the sum: standard deviation beyond which latency and time constant are not told apart


class Loop(NamedTuple):
    """What a log shows of the loop, with the standard deviations of both, see `quadpend_train.flight_logs.identify`."""

    latency: float  # from the exposure to the moment when the command acts, s
    time_constant: float  # of the rate loop, s
    deviations: tuple[float, float]  # infinite where the time constant is at a bound of the fit

    @property
    def is_split(self) -> bool:
        """Whether the log tells latency and time constant apart."""
        return max(self.deviations) < _KNOWN * (self.latency + self.time_constant)

    def sentence(self) -> str:
        """Return both with their 95 % intervals, or that only their sum is known."""
        if not self.is_split:
            return (
                f"only the sum of latency and rate_loop.time_constant is known, {1e3 * sum(self[:2]):.0f} ms: to tell"
                " them apart, fly quick steps of the commanded rates, so small that no rotor reaches its limit"
            )
        latency, constant = (
            f"{1e3 * value:.1f} ms ({1e3 * (value - 2.05 * deviation):.1f} to {1e3 * (value + 2.05 * deviation):.1f})"
            for value, deviation in zip(self[:2], self.deviations, strict=True)
        )
        return f"latency {latency}, rate_loop.time_constant {constant}; in brackets: 95 % intervals"


def loop_of(
    table: pd.DataFrame, lag: float, seconds: tuple[float, float] = Columns.seconds, name: str = "flight"
) -> Loop:
    """Return the loop from a log of `quadpend fly`.

    Args:
        table: The log.
        lag: Of the vehicle's rotors, s.
        seconds: Part of the log to read, from its first row on; only what is in the stage FLY counts.
        name: Of the log, for messages.
    """
    wanted = ["time", "exposure", *_QUATERNION, *_RATES]
    if missing := [each for each in ("stage", *wanted) if each not in table]:
        raise ValueError(f"the loop is identified from a log of `quadpend fly`, which has a column {missing[0]!r}")
    stage, table = table.stage, numeric(name, table, wanted, ["time", "exposure"])
    since = table.time - table.time.min()
    table = table[(stage == "FLY") & (since >= seconds[0]) & (since <= seconds[1])].dropna(subset=_RATES)
    norms = np.linalg.norm(table[_QUATERNION], axis=1)
    seen = table.exposure.notna().to_numpy() & (np.abs(norms - 1.0) < NORM)
    if seen.sum() < _LEAST:
        raise ValueError(
            f"the log {name!r} must have at least {_LEAST} samples in flight in seconds {seconds[0]:g} to"
            f" {seconds[1]:g}, not {seen.sum()}"
        )
    # by the clock of the samples; where there was none, as long before the step as usual
    exposed = table.exposure.fillna(table.time - (table.time - table.exposure).median()).to_numpy()
    if (np.diff(exposed[seen]) < 0.0).any():
        raise ValueError(f"the log {name!r} must have exposures that do not go back")
    grid = np.arange(exposed[0], exposed[-1], _STEP)
    commands = table[_RATES].to_numpy()[np.searchsorted(exposed, grid, side="right") - 1]
    rotation, times = Rotation.from_quat(table[_QUATERNION][seen], scalar_first=True), exposed[seen]
    turned = (rotation[:-1].inv() * rotation[1:]).as_rotvec()[:, :2]
    period = float(np.median(np.diff(times)))
    half, counts = max(1, round(_SMOOTHING / period)), times[:-1] > grid[0] + _SETTLED
    for gap in np.flatnonzero(np.diff(times) > LONGEST_GAP * period):
        counts &= (times[:-1] < times[gap] - _SETTLED) | (times[:-1] > times[gap + 1] + _SETTLED)

    def quick(turns: Floats, slow: float) -> Floats:
        """Return turns without noise and without what is slow."""
        kept, rest = (savgol_filter(turns, 2 * width + 1, 2, axis=0) for width in (half, max(2, round(slow / period))))
        return np.asarray((kept - rest)[counts].ravel())

    def errors(x: Floats, slow: float) -> Floats:
        angles = _STEP * np.cumsum(_response(commands, x[1], lag), axis=0)
        at = np.column_stack([np.interp(times - x[0], grid, angle) for angle in angles.T])
        return quick(np.diff(at, axis=0) - turned, slow)

    def fit(slow: float) -> Any:
        return least_squares(
            errors,
            (0.02, max(0.03, 1.5 * fastest)),
            bounds=((0.0, fastest), (_SLOWEST, _SLOWEST)),
            diff_step=[1e-3, 1e-3],
            x_scale=[0.01, 0.01],
            args=(slow,),
        )

    fastest = max(1e-3, FASTEST_LOOP * lag)
    found, test = map(fit, _SLOW)
    motion = quick(turned, _SLOW[0])
    explained = 1.0 - float(found.fun @ found.fun) / max(float(motion @ motion), 1e-12)
    if explained < _EXPLAINED:
        raise ValueError(
            f"the log {name!r} must have commanded rates that explain most of how the body turns quickly, not"
            f" {max(explained, 0.0):.0%} of it: fly quicker, or check their axes, their signs, and the units (s, rad/s)"
        )
    slopes: Any = found.jac
    inverse = np.linalg.inv(slopes.T @ slopes)
    blocks = np.array([part.sum(axis=0) for part in np.array_split(slopes * found.fun[:, np.newaxis], _BLOCKS)])
    spread = inverse @ (blocks.T @ blocks) @ inverse * _BLOCKS / (_BLOCKS - 1.0)
    latency, constant = found.x.tolist()
    deviations = np.sqrt(np.diag(spread) + (found.x - test.x) ** 2 + (0.5 * _STEP) ** 2)
    if not 1.01 * fastest < constant < 0.99 * _SLOWEST:
        deviations[:] = np.inf
    return Loop(latency, constant, tuple(deviations.tolist()))


def _response(commands: Floats, time_constant: float, lag: float) -> Floats:
    """Return the body rates after commanded ones every `_STEP`, from rest, shape (n, k)."""
    rate_gain, torque_gain = rate_loop_gains(time_constant, lag, _STEP)
    kept = np.exp(-_STEP / lag) if lag > 0.0 else 0.0
    reach = _STEP - lag * (1.0 - kept)
    # rate and acceleration, whose commanded value is rate_gain (command − rate) − torque_gain acceleration
    step = np.array([[1.0, lag * (1.0 - kept)], [0.0, kept]])
    gain = np.array([reach, 1.0 - kept])
    closed = step - np.outer(gain, [rate_gain, torque_gain])
    poles = np.poly(closed)
    zeros = np.poly(closed - rate_gain * np.outer(gain, [1.0, 0.0])) - poles
    return np.asarray(lfilter(zeros, poles, commands, axis=0))
