"""Figures of merit of the experiment: the paper's criteria (8)–(11), and the accuracy of the estimates."""

from typing import Any

import numpy as np

from quadpend_baselines.paper.continuous import Trajectory
from quadpend_baselines.paper.experiment import GUST_COLUMNS, GUSTS, RECORDING_PERIOD, Experiment
from quadpend_gym import State
from quadpend_gym.core.arrays import Floats

CHANNELS = ("F_x", "F_y", "z", "psi")  # m, m, m, rad
_TOLERANCES = (1e-2, 1e-3, 1e-4)  # ε of (8)–(11), m and rad
_MAX_LAG = 20  # recorded samples
_CONVERGED = 6.0  # s, after which the initial error has decayed


def compute_figures_of_merit(experiment: Experiment) -> dict[str, Any]:
    """Return the figures of merit of every trajectory in SI units: errors, times, pendulum angles and estimates."""
    return {name: _figures_of_merit(trajectory) for name, trajectory in experiment.items()}


def _figures_of_merit(trajectory: Trajectory) -> dict[str, Any]:
    before = trajectory.time < GUSTS.onset
    calm, windy = before & (trajectory.time >= _CONVERGED), trajectory.time >= GUSTS.onset + GUSTS.hold
    state, error = State(trajectory.state), np.abs(trajectory.error)
    times = {
        f"{limit:g}": [_convergence_time(trajectory.time, e, limit) for e in error[before].T] for limit in _TOLERANCES
    }
    true, estimates = trajectory.disturbance[windy][:, GUST_COLUMNS].T, trajectory.estimate[windy][:, GUST_COLUMNS].T
    return {
        "largest_error_in_calm_air": _by_channel(error[calm].max(axis=0).tolist()),
        "rmse_in_gusts": _by_channel(np.sqrt(np.mean(error[windy] ** 2, axis=0)).tolist()),
        "convergence_time": {limit: _by_channel(values) for limit, values in times.items()},
        "alpha_at_onset": float(state.alpha[before][-1]),
        "alpha_at_end": float(state.alpha[-1]),
        "beta_range_in_calm_air": [float(state.beta[calm].min()), float(state.beta[calm].max())],
        "estimates": _by_channel([_estimation_quality(*pair) for pair in zip(true, estimates, strict=True)]),
    }


def _by_channel(values: list[Any]) -> dict[str, Any]:
    return dict(zip(CHANNELS, values, strict=True))


def _convergence_time(time: Floats, error: Floats, tolerance: float) -> float | None:
    """Return T₀ of (8)–(11), s: the error stays within `tolerance` from T₀ until the gusts; None if it does not."""
    first = int(np.append(np.flatnonzero(error > tolerance), -1).max()) + 1
    return float(time[first]) if first < error.size else None


def _estimation_quality(true: Floats, estimate: Floats) -> dict[str, float]:
    """Return the root mean square error, the correlation, and the lag (s) of the largest correlation."""
    size = true.size - 2 * _MAX_LAG
    middle = true[_MAX_LAG : _MAX_LAG + size]
    correlations = np.array([np.corrcoef(middle, estimate[lag : lag + size])[0, 1] for lag in range(2 * _MAX_LAG + 1)])
    top = int(np.clip(np.argmax(correlations), 1, correlations.size - 2))
    left, centre, right = correlations[top - 1 : top + 2]
    peak = top - _MAX_LAG + 0.5 * (left - right) / (left - 2.0 * centre + right)  # of a parabola
    return {
        "rmse": float(np.sqrt(np.mean((true - estimate) ** 2))),
        "correlation": float(np.corrcoef(true, estimate)[0, 1]),
        "lag": RECORDING_PERIOD * float(peak),
    }
