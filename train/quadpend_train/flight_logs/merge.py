"""A companion's log with the motors and the gyro of a blackbox, on one clock by their common body rates.

The blackbox has no position and no attitude, the companion's log only some of what the motors did. Both have body
rates: those of the companion's attitude, by parabolas, and those of the gyro, which get the same parabolas. Their
cross-correlation has its maximum near the shift of the clocks. A fit then finds shift and drift between the samples.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from scipy.signal import correlate, correlation_lags

from quadpend_gym.core.arrays import Floats
from quadpend_train.flight_logs.log import FlightLog, rate_of_attitude, smoothed_derivative

_LEAST = 0.7  # correlation of the rates of one flight
_PPM = 1e-6


class Merged(NamedTuple):
    """A companion's log with motors and gyro of a blackbox, and what was found about the clocks."""

    log: FlightLog
    shift: float  # time of the companion's log at the begin of the blackbox, s
    drift: float  # of the blackbox against the companion's log, s/s
    correlation: float  # of the body rates

    def sentence(self, blackbox: str) -> str:
        """Return the figures as a sentence."""
        return (
            f"{blackbox} begins {self.shift:.4f} s after {self.log.name}, its clock is {self.drift / _PPM:.0f} ppm"
            f" faster; correlation of the body rates {self.correlation:.3f}"
        )


def merge(log: FlightLog, blackbox: FlightLog) -> Merged:
    """Return the part of a companion's log that a blackbox covers, with its motors and its gyro.

    They are means over a period of the companion's log, the motor numbers as squares.
    """
    turned = cumulative_trapezoid(blackbox.rate, dx=blackbox.period, axis=0, initial=0)
    theirs, ours = smoothed_derivative(turned, blackbox.period), rate_of_attitude(log.rotation, log.period)
    own = blackbox.period * np.arange(len(blackbox))
    grid = np.arange(0.0, own[-1], log.period)
    found = sum(correlate(a, np.interp(grid, own, b)) for a, b in zip(ours.T, theirs.T, strict=True))
    times = log.period * np.arange(len(log))
    begin = float(correlation_lags(len(log), len(grid))[np.argmax(found)]) * log.period
    covered = np.searchsorted(times, [begin + log.period, begin + own[-1] - log.period]).tolist()
    flown, ours = times[slice(*covered)], ours[slice(*covered)]

    def errors(x: Floats) -> Floats:
        at = (flown - begin - x[0]) * (1.0 + _PPM * x[1])
        return np.ravel([np.interp(at, own, b) - a for a, b in zip(ours.T, theirs.T, strict=True)])

    shift, ppm = least_squares(errors, (0.0, 0.0), x_scale=(0.001, 10.0), diff_step=(1e-3, 1e-3), loss="soft_l1").x
    drift, shift = _PPM * ppm, begin + shift
    expected = errors(np.array([shift - begin, ppm])) + ours.T.ravel()
    correlation = float(np.corrcoef(expected, ours.T.ravel())[0, 1])
    if not correlation > _LEAST:
        raise ValueError(
            f"the logs {log.name!r} and {blackbox.name!r} must be of one flight, but their body rates have a"
            f" correlation of {correlation:.2f}, not more than {_LEAST:g}"
        )
    edges = (flown - shift) * (1.0 + drift)

    def mean(values: Floats) -> Floats:
        """Return the means over a period of the companion around each sample."""
        total = cumulative_trapezoid(values, dx=blackbox.period, axis=0, initial=0).T
        low, high = (edges + share * log.period for share in (-0.5, 0.5))
        return np.column_stack([np.interp(high, own, x) - np.interp(low, own, x) for x in total]) / log.period

    cut, voltage = log.cut(*covered), np.broadcast_to(blackbox.voltage, len(own))
    changed = replace(
        cut,
        rate=mean(blackbox.rate),
        motors=np.sqrt(mean(blackbox.motors**2)),
        has_speeds=blackbox.has_speeds,
        measured=blackbox.measured,
        is_command=blackbox.is_command,
        voltage=np.interp(edges, own, voltage),
        valid=cut.valid & (np.interp(edges, own, blackbox.valid.astype(float)) == 1.0),
        notes=(*cut.notes, *blackbox.notes),
    )
    return Merged(changed, shift, drift, correlation)
