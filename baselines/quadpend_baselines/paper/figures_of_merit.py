"""Figures of merit of the experiment: the paper's criteria (8)–(11), and the accuracy of the estimates."""

from typing import Any

import numpy as np

from quadpend_baselines.paper.continuous import Trajectory
from quadpend_baselines.paper.experiment import GUSTS, RECORDING_PERIOD, Experiment
from quadpend_gym import State
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import FORCE, TORQUE

CHANNELS = ("F_x", "F_y", "z", "psi")  # m, m, m, rad
_GUST_COLUMNS = (FORCE, FORCE + 1, FORCE + 2, TORQUE + 2)  # nonzero disturbances in gusts: N, N, N, N·m
_TOLERANCES = (1e-2, 1e-3, 1e-4)  # ε of (8)–(11), m and rad
_MAX_LAG = 20  # recorded samples
_CONVERGED = 6.0  # s, after which the initial error has decayed


def compute_figures_of_merit(experiment: Experiment) -> dict[str, Any]:
    """Return the figures of merit of every trajectory in SI units: errors, times, pendulum angles and estimates."""
    return {name: _figures_of_merit(trajectory) for name, trajectory in experiment.items()}


def _figures_of_merit(trajectory: Trajectory) -> dict[str, Any]:
    calm = (trajectory.time >= _CONVERGED) & (trajectory.time < GUSTS.onset)
    windy = trajectory.time >= GUSTS.onset + GUSTS.hold
    state = State(trajectory.state)
    return {
        "largest_error_in_calm_air": _by_channel(np.abs(trajectory.error[calm]).max(axis=0)),
        "rmse_in_gusts": _by_channel(np.sqrt(np.mean(trajectory.error[windy] ** 2, axis=0))),
        "convergence_time": {
            f"{tolerance:g}": _by_channel(
                np.array([_convergence_time(trajectory, i, tolerance) for i in range(len(CHANNELS))])
            )
            for tolerance in _TOLERANCES
        },
        "alpha_at_onset": float(state.alpha[trajectory.time < GUSTS.onset][-1]),
        "alpha_at_end": float(state.alpha[-1]),
        "beta_range_in_calm_air": [float(state.beta[calm].min()), float(state.beta[calm].max())],
        "estimates": {
            channel: _estimation_quality(trajectory.disturbance[windy, column], trajectory.estimate[windy, column])
            for channel, column in zip(CHANNELS, _GUST_COLUMNS, strict=True)
        },
    }


def _by_channel(values: Floats) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in zip(CHANNELS, values, strict=True)}


def _convergence_time(trajectory: Trajectory, channel: int, tolerance: float) -> float:
    """Return T₀ of (8)–(11), s: the error stays within `tolerance` from T₀ until the gusts; inf if it does not."""
    before_gusts = trajectory.time < GUSTS.onset
    outside = np.flatnonzero(np.abs(trajectory.error[before_gusts, channel]) > tolerance)
    if outside.size == 0:
        return 0.0
    return float(trajectory.time[outside[-1] + 1]) if outside[-1] + 1 < before_gusts.sum() else np.inf


def _estimation_quality(true: Floats, estimate: Floats) -> dict[str, float]:
    """Return the root mean square error, the correlation, and the lag (s) of the largest correlation."""
    size = true.size - 2 * _MAX_LAG
    middle = true[_MAX_LAG : _MAX_LAG + size]
    correlations = np.array([np.corrcoef(middle, estimate[lag : lag + size])[0, 1] for lag in range(2 * _MAX_LAG + 1)])
    return {
        "rmse": float(np.sqrt(np.mean((true - estimate) ** 2))),
        "correlation": float(np.corrcoef(true, estimate)[0, 1]),
        "lag": RECORDING_PERIOD * _peak(correlations),
    }


def _peak(correlations: Floats) -> float:
    """Return the lag in samples of the largest correlation, from a parabola; the first lag is −`_MAX_LAG`."""
    top = int(np.clip(np.argmax(correlations), 1, correlations.size - 2))
    left, centre, right = correlations[top - 1 : top + 2]
    return float(top - _MAX_LAG + 0.5 * (left - right) / (left - 2.0 * centre + right))
