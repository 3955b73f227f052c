"""Figures of merit of the experiment: the paper's criteria (8)–(11) in numbers, and how good the estimates are."""

from typing import Any

import numpy as np

from quadpend_baselines.paper.experiment import GUSTS, RECORDED, Experiment
from quadpend_baselines.paper.trajectory import Trajectory
from quadpend_gym import State
from quadpend_gym.core.arrays import Floats

CHANNELS = ("F_x", "F_y", "z", "psi")  # m, m, m, rad
_DISTURBED = (0, 1, 2, 8)  # columns of the disturbance in which the gusts blow: N, N, N, N·m
_TOLERANCES = (1e-2, 1e-3, 1e-4)  # ε of (8)–(11), m and rad
_LARGEST_LAG = 20  # records
_CONVERGED = 6.0  # s, after which the start no longer matters


def compute_figures_of_merit(experiment: Experiment) -> dict[str, Any]:
    """Numbers for every trajectory, in SI units: errors, convergence times, pendulum, estimates."""
    return {name: _merit(trajectory) for name, trajectory in experiment.trajectories.items()}


def _merit(trajectory: Trajectory) -> dict[str, Any]:
    calm = (trajectory.time >= _CONVERGED) & (trajectory.time < GUSTS.onset)
    windy = trajectory.time >= GUSTS.onset + GUSTS.hold
    view = State(trajectory.state)
    return {
        "largest_error_in_calm_air": _by_channel(np.abs(trajectory.error[calm]).max(axis=0)),
        "rmse_in_gusts": _by_channel(np.sqrt(np.mean(trajectory.error[windy] ** 2, axis=0))),
        "convergence_time": {
            f"{tolerance:g}": _by_channel(np.array([_settles(trajectory, i, tolerance) for i in range(4)]))
            for tolerance in _TOLERANCES
        },
        "alpha_at_onset": float(view.alpha[trajectory.time < GUSTS.onset][-1]),
        "alpha_at_end": float(view.alpha[-1]),
        "beta_range_in_calm_air": [float(view.beta[calm].min()), float(view.beta[calm].max())],
        "estimates": {
            channel: _estimate(trajectory.disturbance[windy, column], trajectory.estimate[windy, column])
            for channel, column in zip(CHANNELS, _DISTURBED, strict=True)
        },
    }


def _by_channel(values: Floats) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in zip(CHANNELS, values, strict=True)}


def _settles(trajectory: Trajectory, channel: int, tolerance: float) -> float:
    """T₀ of (8)–(11): the time (s) from which the error stays within `tolerance` until the gusts; inf if never."""
    before = trajectory.time < GUSTS.onset
    outside = np.flatnonzero(np.abs(trajectory.error[before, channel]) > tolerance)
    if outside.size == 0:
        return 0.0
    return float(trajectory.time[outside[-1] + 1]) if outside[-1] + 1 < before.sum() else np.inf


def _estimate(true: Floats, seen: Floats) -> dict[str, float]:
    """Root mean square error, correlation, and the lag (s) at which the correlation is largest."""
    size = true.size - 2 * _LARGEST_LAG
    middle = true[_LARGEST_LAG : _LARGEST_LAG + size]
    correlations = np.array([np.corrcoef(middle, seen[lag : lag + size])[0, 1] for lag in range(2 * _LARGEST_LAG + 1)])
    return {
        "rmse": float(np.sqrt(np.mean((true - seen) ** 2))),
        "correlation": float(np.corrcoef(true, seen)[0, 1]),
        "lag": RECORDED * _peak(correlations),
    }


def _peak(correlations: Floats) -> float:
    """Where the correlations, at lags from −`_LARGEST_LAG` on, are largest, by a parabola through the top three."""
    top = int(np.clip(np.argmax(correlations), 1, correlations.size - 2))
    before, at, after = correlations[top - 1 : top + 2]
    return float(top - _LARGEST_LAG + 0.5 * (before - after) / (before - 2.0 * at + after))
