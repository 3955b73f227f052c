"""Flight logs as arrays on an even time grid, made of tables with named columns.

World frame: z up. Body frame: x forward, y left, z up. Quaternions are w, x, y, z, and map body vectors to the world.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation, Slerp

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.settings import Interval, Range, settings, suggest

_SMOOTHING = 0.05  # s: half width of the parabola that differentiates a log without velocities or body rates
_HARMLESS = 0.02  # s: a quiet log of 1 kHz repeats its numbers for as long
LONGEST_GAP = 3.5  # usual distances between two positions; windows of a replay contain no longer gap
_COUNTERS = (2**24 * 1e-6, 2**16 * 1e-3, 2**32 * 1e-6, 2**24 * 1e-3, 2**32 * 1e-3)  # s, after which they begin again
_FEWEST = 50  # rows of each of several flights in a file
_PERIODS = (1e-4, 0.1)  # s: a wrong unit of the time, by a factor of 1000, leaves this range
_JUMP = 0.5  # m: longest step between two samples, beyond that of the velocity; an estimator that resets its position
_RARE = 0.1  # largest share of rows with such a step; more have another unit
_TURN = 0.35  # rad: longest turn between two samples, beyond that of the body rate; motion capture that flips
NORM = 0.1  # largest deviation of the norm of a quaternion from 1
_SPIKE, _SPIKES = 1.0, 20.0  # rad/s, and median deviations, of a body rate from the median of five samples
# largest motor number as a multiple of the 99 % quantile
_FASTEST = dict.fromkeys(("rad/s", "rpm", "100 rpm"), 2.0) | {"N": 4.0}
_STRAIGHT = 1e-3, 0.98  # share of this quantile: samples this much closer to a straight line are interpolated
_REST, _SPAN = (0.003, 0.005), 0.5  # m and half a rad, in which a vehicle at rest stays for so long, s
_FALLEN = 0.5  # cosine of the tilt in which a crashed vehicle ends
NOMINAL = 3.7  # V: voltages of a battery are in units of that of one lithium cell
_LARGEST = 1e8  # of all numbers but the time; northings of UTM are up to 1e7 m
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_SPEEDS = {"rad/s": 1.0, "rpm": np.pi / 30.0, "100 rpm": np.pi / 0.3, "N": 1.0, "1": 1.0, "pwm16": 1.0 / 65535.0}
_RATES = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
Three = tuple[str, str, str]
Four = tuple[str, str, str, str]


@settings
class Columns:
    """Names and units of the columns of a log."""

    time: str = "time"
    position: Three | None = ("x", "y", "z")  # m; None: the log has neither position nor velocity
    # body to world, in the order w, x, y, z; None: integral of the body rate, which then must be given
    quaternion: Four | None = ("qw", "qx", "qy", "qz")
    motors: Four = ("motor1", "motor2", "motor3", "motor4")  # in the order of the vehicle's rotors
    velocity: Three | None = None  # m/s, in the world frame; None: derivative of the position
    rate: Three | None = None  # in the body frame; None: derivative of the attitude
    rate_unit: Literal["rad/s", "deg/s"] = "rad/s"
    pole_direction: Three | None = None  # from the pivot along the pole, world frame, of any length; None: no pole flew
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    # speeds; thrusts in N; or commands from 0 to 1, or to 65535 ("pwm16"), whose squares are about proportional to them
    motor_unit: Literal["rad/s", "rpm", "100 rpm", "N", "1", "pwm16"] = "rad/s"
    voltage: str | None = None  # of the battery, V, by which commands make more or less thrust
    measured: bool = False  # measured speeds, not commanded ones: the thrust does not lag behind them
    poles: Annotated[int, Range(1, 100)] = 1  # pairs of poles of a motor: electrical revolutions in each of its own
    # "up": z up, body x forward, y left; "down": z down, body x forward, y right, as in PX4
    frame: Literal["up", "down"] = "up"
    seconds: Annotated[Interval, Range(0.0, 1e9, "s")] = (0.0, 1e9)  # part of the log to read, from its first row on

    def __post_init__(self) -> None:
        if self.rate is None and self.quaternion is None:
            raise ValueError("columns must name the quaternion, the rate, or both")
        if twice := [name for name in self.names if self.names.count(name) > 1]:
            raise ValueError(f"columns must name {twice[0]!r} once")

    @property
    def names(self) -> list[str]:
        """The names of all columns."""
        vectors = (self.position, self.velocity, self.quaternion, self.rate, self.pole_direction)
        voltage = [self.voltage] if self.voltage else []
        return [self.time, *self.motors, *voltage, *(name for names in vectors for name in names or ())]


DEFAULT = Columns(velocity=("vx", "vy", "vz"), rate=("wx", "wy", "wz"))


@dataclass(frozen=True)
class FlightLog:
    """A flight at n times with even distances.

    Attributes:
        name: Name of the log.
        period: Distance of the times, s.
        position: World frame, m, shape (n, 3).
        velocity: World frame, m/s, shape (n, 3).
        quaternion: Body to world, shape (n, 4).
        rate: Body rate, body frame, rad/s, shape (n, 3).
        motors: Speeds of the rotors, rad/s, in the order of the vehicle; or numbers whose squares are proportional to
            the thrusts; shape (n, 4).
        has_speeds: Whether `motors` are speeds in rad/s.
        measured: Whether `motors` are measured, so that the thrust does not lag behind them.
        has_position: Whether position and velocity are measured; otherwise they are zero.
        valid: Whether the log has samples around a time, shape (n,).
        pole: Direction of the pole from its pivot, world frame, and its derivative, 1/s, shape (n, 6); None: no pole.
        voltage: Voltage of the battery in units of `NOMINAL`, shape (n,); ones if it is not logged.
        is_command: Whether `motors` are commands, so that their squares are only about proportional to the thrusts.
        notes: Sentences about what was left out.
        has_velocity: Whether the velocity is logged, and no derivative of the position.
    """

    name: str
    period: float
    position: Floats
    velocity: Floats
    quaternion: Floats
    rate: Floats
    motors: Floats
    has_speeds: bool
    measured: bool
    has_position: bool
    valid: Any
    pole: Floats | None = None
    voltage: Floats = field(default_factory=lambda: np.ones(1))
    is_command: bool = False
    notes: tuple[str, ...] = ()
    has_velocity: bool = False

    def __len__(self) -> int:
        return len(self.position)

    @property
    def rotation(self) -> Rotation:
        """The attitude, body to world."""
        return Rotation.from_quat(self.quaternion, scalar_first=True)

    @property
    def trim(self) -> Floats:
        """The mean share of each rotor in the squared motor numbers, shape (4,)."""
        squares = (self.motors**2)[self.valid].mean(axis=0)
        return np.asarray(squares / squares.sum())

    def trimmed(self, trim: Floats) -> "FlightLog":
        """Return the log with the motor numbers that have this `trim`."""
        return replace(self, motors=self.motors * np.sqrt(trim / self.trim))

    def gaps(self) -> list[str]:
        """Return sentences about what was left out and about the gaps in the log, if there are any."""
        share = 1.0 - float(self.valid.mean())
        gaps = [f"{share:.1%} of the log {self.name} is in gaps; windows with gaps are left out"] if share else []
        return [*self.notes, *gaps]

    def part(self, first: float, last: float) -> "FlightLog":
        """Return the part from one share of the log to another, such as the first 70 %: ``part(0.0, 0.7)``."""
        return self.cut(int(first * len(self)), int(last * len(self)))

    def cut(self, begin: int, end: int) -> "FlightLog":
        """Return the samples from one to before another."""
        cut = slice(begin, end)
        arrays = ("position", "velocity", "quaternion", "rate", "motors", "valid")
        pole = None if self.pole is None else self.pole[cut]
        voltage = self.voltage if len(self.voltage) == 1 else self.voltage[cut]
        return replace(self, pole=pole, voltage=voltage, **{name: getattr(self, name)[cut] for name in arrays})


def make_log(name: str, table: pd.DataFrame, columns: Columns) -> FlightLog:
    """Return a log from a table: on an even grid, in the package's frames, with the derivatives that it lacks.

    Outliers, times without samples, and the rest before and after a flight are left out, see `FlightLog.notes`. A
    table without any column of the pole's direction is the log of a flight without a pole.
    """
    if columns.pole_direction and not any(each in table for each in columns.pole_direction):
        columns = replace(columns, pole_direction=None)
    stamps, numbers = _numbers(name, table, columns)
    outliers, notes = _outliers(numbers, columns), list[str]()
    for what, rows in outliers.items():
        notes += [f"{int(rows.sum())} rows of the log {name} with {what} are left out"] if rows.any() else []
    numbers[np.any([*outliers.values()], axis=0)] = np.nan
    if 2 * numbers.notna().all(axis=1).sum() < len(numbers):  # each topic has rows of its own
        own = (columns.quaternion or columns.rate or columns.motors)[0]
        between = numbers.set_axis(stamps).interpolate("index", limit_area="inside").set_axis(numbers.index)
        numbers = between[numbers[own].notna()].reindex(numbers.index)
        notes.append(f"empty cells of the log {name} are interpolated, at the times of {own}")
    since = stamps - np.min(stamps, initial=np.inf)
    keep = numbers.notna().all(axis=1) & (since >= columns.seconds[0]) & (since <= columns.seconds[1])
    time, first = np.unique(stamps[keep], return_index=True)
    table = numbers[keep].iloc[first]
    if len(time) < 10 or 2 * len(time) < keep.sum():
        counts, (begin, end) = numbers.count(), columns.seconds
        raise ValueError(
            f"the log {name!r} must have at least ten complete rows, most of them with their own time stamp, not"
            f" {keep.sum()} with {len(time)} time stamps in seconds {begin:g} to {end:g}; its column"
            f" {counts.idxmin()!r} has {counts.min()} numbers"
        )
    period = round(float(np.median(np.diff(time))), 6)
    if not _PERIODS[0] <= period <= _PERIODS[1]:
        raise ValueError(
            f"the log {name!r} must have a row every {_PERIODS[0]:g} to {_PERIODS[1]:g} s, not every {period:g} s;"
            f" check its time_unit, which is {columns.time_unit!r}"
        )
    if time[-1] - time[0] > 100.0 * len(time) * period or time[-1] - time[0] <= 2.0 * _SMOOTHING:
        raise ValueError(
            f"the log {name!r} must last longer than {2.0 * _SMOOTHING:g} s and must not be nearly all gap, but its"
            f" {len(time)} complete rows are from {time[0]:.10g} to {time[-1]:.10g} s"
        )
    grid = np.minimum(time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-3) + 1), time[-1])

    def resampled(names: Sequence[str], rows: Any = slice(None)) -> Floats:
        return np.column_stack([np.interp(grid, time[rows], table[name].to_numpy(float)[rows]) for name in names])

    seen = np.full(len(time), True)  # motion capture that loses the vehicle repeats the last position: no sample
    if columns.position:
        seen[1:-1] = (np.diff(table[list(columns.position)].to_numpy(float), axis=0) != 0.0).any(axis=1)[:-1]

    flip = np.array([1.0, 1.0, 1.0] if columns.frame == "up" else [1.0, -1.0, -1.0])
    if columns.quaternion:
        quaternions = table[list(columns.quaternion)].to_numpy(float) * np.append(1.0, flip)
        rotation = Slerp(time, Rotation.from_quat(quaternions, scalar_first=True))(grid)
    rate = (
        flip * resampled(columns.rate) * _RATES[columns.rate_unit]
        if columns.rate
        else rate_of_attitude(rotation, period)
    )
    if not columns.quaternion:
        rotation = _integral(rate, period)
    position = flip * resampled(columns.position, seen) if columns.position else np.zeros((len(grid), 3))
    velocity = flip * resampled(columns.velocity) if columns.velocity else smoothed_derivative(position, period)
    pole = columns.pole_direction and pole_motion(flip * resampled(columns.pole_direction, seen), period)
    motors = resampled(columns.motors) * _SPEEDS[columns.motor_unit] / columns.poles
    jump = np.full(len(grid) - 1, False)
    if columns.position:
        jump |= np.linalg.norm(np.diff(position, axis=0) - period * velocity[1:], axis=1) > _JUMP
        if jump.mean() > _RARE:
            raise ValueError(
                f"the log {name!r} has positions that jump by more than {_JUMP:g} m in {jump.mean():.0%} of its rows:"
                " check their unit, m, and that of the velocity, m/s"
            )
    if columns.quaternion:
        turn = (rotation[:-1].inv() * rotation[1:]).magnitude()
        jump |= turn > _TURN + 1.5 * period * np.linalg.norm(rate[1:], axis=1)
    breaks = [(grid[i], grid[i + 1]) for i in np.flatnonzero(jump)]
    groups = [list(each) for each in (columns.position, columns.motors, columns.rate) if each]
    for samples in (time[seen], *(time[_knots(time, table[each])] for each in groups)):
        distances = np.diff(samples)
        longest = max(_HARMLESS, LONGEST_GAP * float(np.median(distances)))
        breaks += [(samples[i], samples[i + 1]) for i in np.flatnonzero(distances > longest)]
    valid = np.full(len(grid), True)
    for begin, end in breaks:  # derivatives near a gap contain it
        valid &= (grid <= begin - _SMOOTHING) | (grid >= end + _SMOOTHING)
    log = FlightLog(
        name,
        period,
        position,
        velocity,
        rotation.as_quat(scalar_first=True),
        rate,
        np.sqrt(np.maximum(motors, 0.0)) if columns.motor_unit == "N" else motors,
        columns.motor_unit in ("rad/s", "rpm", "100 rpm"),
        columns.measured,
        columns.position is not None,
        valid,
        pole,
        resampled([columns.voltage])[:, 0] / NOMINAL if columns.voltage else np.ones(1),
        columns.motor_unit in ("1", "pwm16"),
        tuple(notes),
        columns.velocity is not None,
    )
    return _flight(log) if columns.position and columns.quaternion else log


def _outliers(numbers: pd.DataFrame, columns: Columns) -> dict[str, Any]:
    """Return by their names the kinds of rows whose numbers no vehicle makes."""
    motors, out = numbers[list(columns.motors)], dict[str, Any]()
    high: Any = _FASTEST.get(columns.motor_unit, np.inf) * motors.quantile(0.99)
    low, high = (0.0, 65535.0) if columns.motor_unit == "pwm16" else (-np.inf, high)
    out["a motor out of its range"] = ((motors < low) | (motors > high)).any(axis=1)
    if columns.rate:
        rates = numbers[list(columns.rate)] * _RATES[columns.rate_unit]
        away = (rates - rates.rolling(5, center=True, min_periods=1).median()).abs()
        out["a spike of the body rate"] = (away > np.maximum(_SPIKE, _SPIKES * away.median())).any(axis=1)
    if columns.quaternion:
        norms = np.linalg.norm(numbers[list(columns.quaternion)], axis=1)
        out["no attitude"] = np.abs(norms - 1.0) > NORM
    return out


def _knots(time: Floats, table: pd.DataFrame) -> Any:
    """Return which rows are no interpolation between their neighbours, shape (n,); the first and the last one are none.

    Tables of several topics repeat, interpolate or extrapolate what was not sampled at their times.
    """
    numbers, share = table.to_numpy(float), np.diff(time)[:-1, np.newaxis] / (time[2:] - time[:-2])[:, np.newaxis]
    away = np.abs((1.0 - share) * numbers[:-2] + share * numbers[2:] - numbers[1:-1])
    share_of, quantile = _STRAIGHT
    return np.pad((away > share_of * np.quantile(away, quantile, axis=0)).any(axis=1), 1, constant_values=True)


def _flight(log: FlightLog) -> FlightLog:
    """Return the log from the first to the last sample of the flight, and mark the rest on the ground as gaps."""
    width = max(3, round(_SPAN / log.period))
    moved = [
        pd.DataFrame(each).rolling(width, center=True, min_periods=1) for each in (log.position, log.quaternion[:, 1:])
    ]
    rest = np.all(
        [((each.max() - each.min()) < most).all(axis=1) for each, most in zip(moved, _REST, strict=True)], axis=0
    )
    valid, upright = log.valid & ~rest, log.rotation.as_matrix()[:, 2, 2] > _FALLEN
    if not upright[-1] and upright.any():
        valid[max(0, int(np.flatnonzero(upright)[-1]) - width) :] = False
    kept = np.flatnonzero(valid)
    if len(kept) < width or not np.ptp(log.position[kept], axis=0).any():
        raise ValueError(
            f"the log {log.name!r} shows no flight: its position hardly changes, or its samples are no samples"
        )
    begin, end = int(kept[0]), int(kept[-1]) + 1
    note = f"{log.period * (len(log) - end + begin):.3g} s at the ends of the log {log.name} show no flight"
    notes = (*log.notes, note) if end - begin < len(log) else log.notes
    return replace(log, valid=valid, notes=notes).cut(begin, end)


def numeric(name: str, table: pd.DataFrame, wanted: Sequence[str], stamps: Sequence[str]) -> pd.DataFrame:
    """Return the named columns of a table as numbers; only those of the `stamps` may be large."""
    for column in wanted:
        if column not in table or f"{column}.1" in table:  # pandas renames a second x to x.1
            found = "two columns" if column in table else "no column"
            present = ", ".join(repr(each[:30]) for each in table.columns[:30])
            raise ValueError(
                f"the log {name!r} has {found} {column!r}{suggest(column, table.columns)}; name its columns, which are"
                f" {present}"
            )
    numbers = table[list(wanted)].apply(pd.to_numeric, errors="coerce").astype(float)
    wrong = (numbers.isna() & table[list(wanted)].notna()) | (numbers.abs() > _LARGEST).assign(
        **dict.fromkeys(stamps, False)
    )
    for row, column in np.argwhere(wrong.to_numpy())[:1]:
        cell = str(table[wanted[column]].iat[row])[:30]
        raise ValueError(
            f"the log {name!r} has {cell!r} in column {wanted[column]!r} of row {row + 1}; cells must be numbers up to"
            f" {_LARGEST:g}, or empty"
        )
    return numbers


def _numbers(name: str, table: pd.DataFrame, columns: Columns) -> tuple[Floats, pd.DataFrame]:
    """Return the stamps in s and the named columns of all rows with a stamp, if they can be those of a flight."""
    numbers = numeric(name, table, columns.names, [columns.time])
    numbers = numbers[np.isfinite(numbers[columns.time])]
    time = _unwrapped(numbers[columns.time].to_numpy() * _SECONDS[columns.time_unit])
    for i in np.flatnonzero(np.diff(time) < 0.0)[:1]:
        raise ValueError(
            f"the log {name!r} must have increasing time stamps, but row {numbers.index[i + 1] + 1} goes back from"
            f" {time[i]:.10g} to {time[i + 1]:.10g} s; split the file there, or"
            f" check its time_unit, which is {columns.time_unit!r}"
        )
    if columns.quaternion:
        norms = np.linalg.norm(numbers[list(columns.quaternion)], axis=1)
        wrong = np.flatnonzero(np.abs(norms - 1.0) > NORM)
        if 2 * len(wrong) > len(norms):
            raise ValueError(
                f"the log {name!r} must have quaternions of norm 1, not {norms[wrong[0]]:.3g} as in row"
                f" {numbers.index[wrong[0]] + 1}"
            )
    return time, numbers


def _unwrapped(time: Floats) -> Floats:
    """Return stamps, s, whose counter does not begin again."""
    steps, out = np.diff(time), time.copy()
    usual = float(np.median(np.abs(steps))) if len(steps) else 0.0
    for span in _COUNTERS:
        near = min(LONGEST_GAP * usual, 0.01 * span)
        out[1:] += span * np.cumsum((steps < 0.0) & (np.abs(steps + span) <= near))
    return out


def flights(table: pd.DataFrame, columns: Columns) -> list[pd.DataFrame]:
    """Return the parts of a table that begin where the time goes back: a file may have several flights."""
    if columns.time not in table:
        return [table]
    stamps = pd.to_numeric(table[columns.time], errors="coerce").astype(float)
    stamps = stamps[np.isfinite(stamps)]
    back = np.flatnonzero(np.diff(_unwrapped(stamps.to_numpy() * _SECONDS[columns.time_unit])) < 0.0) + 1
    begins = [0, *table.index.get_indexer(stamps.index[back]).tolist(), len(table)]
    return [table[a:b] for a, b in pairwise(begins)] if min(np.diff(begins)) >= _FEWEST else [table]


def pole_motion(along: Floats, period: float) -> Floats:
    """Return `FlightLog.pole` from vectors along the pole, shape (n, 3)."""
    direction = along / np.linalg.norm(along, axis=1, keepdims=True)
    return np.hstack([direction, smoothed_derivative(direction, period)])


def smoothed_derivative(values: Floats, period: float) -> Floats:
    """Return the derivative by time of values of shape (n, …), from parabolas through ± 50 ms."""
    half = max(1, round(_SMOOTHING / period))
    return np.asarray(savgol_filter(values, 2 * half + 1, 2, deriv=1, delta=period, axis=0))


def rate_of_attitude(rotation: Rotation, period: float) -> Floats:
    """Return the body rate of an attitude over time, rad/s, shape (n, 3)."""
    matrix = rotation.as_matrix()
    change = np.einsum("nji,njk->nik", matrix, smoothed_derivative(matrix, period))  # RᵀṘ
    return np.asarray((change[:, [2, 0, 1], [1, 2, 0]] - change[:, [1, 2, 0], [2, 0, 1]]) / 2.0)


def _integral(rate: Floats, period: float) -> Rotation:
    """Return the attitude that begins level and turns with the body rate."""
    turns, out = Rotation.from_rotvec(period * 0.5 * (rate[1:] + rate[:-1])), [Rotation.identity()]
    for turn in turns:
        out.append(out[-1] * turn)
    return Rotation.concatenate(out)
