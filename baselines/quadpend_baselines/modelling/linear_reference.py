"""The linear reference: the smallest error that a causal controller can have in the linear model of a scenario.

The vehicle at hover (`linear_loop.vehicle_model`, x), the shaping filter of the wind (w, driven by white noise n) and
white noise v of the sensors make one linear system with Gaussian inputs:

    (1)  x_{k+1} = A x_k + B a_k + E C_w w_k,    w_{k+1} = Φ w_k + L n_k,    y_k = C x_k + v_k,    e_k = C_e x_k

Of all causal controllers, also nonlinear ones, the linear-quadratic-Gaussian one (LQG) has the smallest stationary mean
of |e|² + ρ|a|² there: the feedback of the Riccati equation, of the estimate of x and w by the Kalman filter with the
true covariances. The reference is √E|e|² for ρ → 0. With the covariances P of the prediction and Σ = C P Cᵀ + V of the
innovation, the gains K and F, and the covariance X of the estimate,

    (2)  E|e|² = tr C_e (X + P − K C P) C_eᵀ,    X = (A − B F) X (A − B F)ᵀ + K Σ Kᵀ       A, B, C here with w

It is a bound for the linear model, and a yardstick for the nonlinear vehicle: the limits of the actions, which ρ → 0
ignores, make it lower than what is possible, and it knows the vehicle and the statistics of the wind exactly.

Turbulence acts by the slope of the drag at its mean wind V, ½ ρ A (|V| I + V Vᵀ/|V|), which also damps the motion; the
mean force and the tilt against it are left out. The extra `control` is needed.
"""

from typing import Any, NamedTuple

import control
import numpy as np
from scipy.linalg import block_diag, solve_discrete_lyapunov

from quadpend_baselines.modelling.linear_loop import vehicle_model
from quadpend_gym import actuators, sensors
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.models import kind_of
from quadpend_gym.physics.drag import AIR_DENSITY
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Channel
from quadpend_gym.wind import WIND_FIELDS, WIND_SIZE, Drawn, Dryden, OrnsteinUhlenbeck, Rescaled, Sum
from quadpend_gym.wind.filters import discretise

_EFFORT = 1e-5  # m, √ρ: the error that counts as much as an action of 1
_LEAST = 1e-6  # of the position (m): tolerances, process noise in a period, which make all states count and uncertain
_LEAST_NOISE = 1e-6  # standard deviation of a measurement that has no noise, SI units
_FIELDS = {  # fields of `Noise` by the names of the measurements
    "position": "position",
    "velocity": "velocity",
    "attitude": "euler",
    "rate": "euler_rate",
    "pendulum": "direction",
    "pendulum_rate": "direction_rate",
}


class _Shaping(NamedTuple):
    """Φ, L and C_w of equation (1), and the mean wind, m/s."""

    transition: Floats
    noise: Floats
    output: Floats  # shape (12, m)
    mean: Floats  # shape (3,)


def _refuse(what: str) -> ValueError:
    return ValueError(f"the linear reference applies to hover in fluctuating wind and white noise, not to {what}")


def _shapings(models: Any, period: float, scale: Floats) -> list[_Shaping]:
    """Return the shaping filters of winds whose twelve columns are multiplied by `scale`."""
    found = []
    for model in models:
        if isinstance(model, Sum):
            found += _shapings(model.models, period, scale)
        elif isinstance(model, Rescaled):
            factors = np.concatenate([np.full(6, model.scale), model.torque_factors, np.ones(3)])
            found += _shapings(model.parts, period, factors * scale)
        elif isinstance(model, Drawn) and model.strength[0] == model.strength[1]:
            found += _shapings(model.parts, period, model.strength[0] * scale)  # its heading does not change the error
        elif isinstance(model, OrnsteinUhlenbeck) and not model.moves_air:
            decay, load = np.exp(-period / model.time_constant), np.diag(scale * model.load)
            found.append(_Shaping(decay * np.eye(12), np.sqrt(1.0 - decay**2) * np.eye(12), load, np.zeros(3)))
        elif isinstance(model, Dryden):
            system, velocity = discretise(model.filter, period), WIND_FIELDS["velocity"]
            cosine, sine = np.cos(model.heading), np.sin(model.heading)
            turn = scale[velocity] * np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
            output = np.zeros((WIND_SIZE, len(system.transition)))
            output[velocity] = turn @ model.filter.c
            found.append(_Shaping(*system, output, model.mean_speed * turn[:, 0]))
        else:
            raise _refuse(f"the wind {kind_of(model)!r}")
    return found


def _noise(scenario: Scenario, measured: list[str]) -> Floats:
    """Return the covariance of v in equation (1)."""
    variance = np.full(len(measured), _LEAST_NOISE**2)
    for model in scenario.sensors:
        if isinstance(model, sensors.Noise):
            channels = [getattr(model, _FIELDS[name.partition("[")[0]]) for name in measured]
            if any(Channel(channel.white) != channel for channel in channels):
                raise _refuse("biases, random walks and quantisation")
            variance += [channel.white**2 for channel in channels]
        elif not isinstance(model, sensors.Delay):
            raise _refuse(f"the sensor {kind_of(model)!r}")
    return np.diag(variance)


class LinearProblem(NamedTuple):
    """Equation (1) of a scenario."""

    A: Floats  # of x and w, shape (n, n)
    B: Floats  # of the actions
    N: Floats  # of the noise n
    C: Floats  # of the measurements
    error: Floats  # C_e
    V: Floats  # covariance of v


def linear_problem(scenario: Scenario) -> LinearProblem:
    """Return equation (1) of a scenario; a scenario to which it does not apply is a ValueError."""
    references = scenario.task.references
    if scenario.task.trajectory is not None or any(
        (references.circle, references.figure_eight, references.helix, references.slalom, references.yaw_amplitude)
    ):
        raise _refuse("motion")
    if scenario.parameters is not None:
        raise _refuse("unknown parameters")
    if not scenario.loop_known or scenario.loop is not None:
        raise _refuse("an unknown loop")
    for model in scenario.actuators:
        if isinstance(model, actuators.PacketLoss | actuators.GyroBias):
            raise _refuse(f"the actuator {kind_of(model)!r}")
    shapings = _shapings(scenario.wind_models, scenario.period, np.ones(WIND_SIZE))
    if not shapings:
        raise _refuse("still air")
    vehicle = _damped(vehicle_model(scenario), scenario, np.sum([item.mean for item in shapings], axis=0))
    measured = vehicle.output_labels[3:]
    by_wind = np.hstack([item.output for item in shapings])
    transition, noise = (block_diag(*(item[i] for item in shapings)) for i in (0, 1))
    none = np.zeros((len(transition), vehicle.nstates))
    return LinearProblem(
        np.block([[vehicle.A, vehicle.B[:, :WIND_SIZE] @ by_wind], [none, transition]]),
        np.vstack([vehicle.B[:, -4:], none[:, :4]]),
        np.vstack([np.zeros((vehicle.nstates, len(noise))), noise]),
        np.hstack([vehicle.C[3:], none[:, : len(measured)].T]),
        np.hstack([vehicle.C[:3], none[:, :3].T]),
        _noise(scenario, measured),
    )


def _damped(vehicle: Any, scenario: Scenario, mean: Floats) -> Any:
    """Return the vehicle in a mean wind, m/s, in which the drag has a slope."""
    speed = float(np.linalg.norm(mean))
    if speed == 0.0:
        return vehicle
    p, labels = scenario.simulation.parameters, vehicle.state_labels
    shape = 0.5 * AIR_DENSITY * (speed * np.eye(3) + np.outer(mean, mean) / speed)
    fields = [vehicle.B[:, WIND_FIELDS[name]] for name in ("force", "bob_force")]
    by_bob = p.bob_drag_area * fields[1] @ shape
    by_air = p.quadrotor_drag_area * fields[0] @ shape + by_bob
    A, B = np.array(vehicle.A), np.array(vehicle.B)
    velocity, pendulum = labels.index("velocity[0]"), labels.index("pendulum_rate[0]")
    A[:, velocity : velocity + 3] -= by_air
    A[:, pendulum : pendulum + 2] -= p.rod_length * by_bob[:, :2]
    B[:, WIND_FIELDS["velocity"]] += by_air
    names = {"states": labels, "inputs": vehicle.input_labels, "outputs": vehicle.output_labels}
    return control.ss(A, B, vehicle.C, vehicle.D, vehicle.dt, **names)


def _riccati(A: Floats, B: Floats, Q: Floats, R: Floats) -> Floats:
    """Return the solution of the Riccati equation by doubling: step k is 2ᵏ steps of its recursion.

    SciPy's solver fails in Dryden turbulence, whose filter has double poles. Structured doubling: Chu, Fan, Lin & Wang,
    International Journal of Control 77(8), 2004.
    """
    G, H, change = B @ np.linalg.solve(R, B.T), Q, np.inf
    while change > 1e-12:
        share = np.linalg.inv(np.eye(len(A)) + G @ H)
        A, G, added = A @ share @ A, G + A @ share @ G @ A.T, A.T @ H @ share @ A
        H, change = H + 0.5 * (added + added.T), np.abs(added).max() / np.abs(H).max()
        G = 0.5 * (G + G.T)
    return H


def _design(problem: LinearProblem) -> tuple[Floats, Floats, Floats, Floats]:
    """Return P, Σ, K and F of equation (2)."""
    A, B, N, C, error, V = problem
    least = _LEAST**2 * np.eye(len(A))
    P = _riccati(A.T, C.T, N @ N.T + least, V)
    innovation = C @ P @ C.T + V
    R = _EFFORT**2 * np.eye(B.shape[1])
    S = _riccati(A, B, error.T @ error + least, R)
    K, F = np.linalg.solve(innovation, C @ P).T, np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
    return P, innovation, K.astype(np.float64), F.astype(np.float64)


def linear_reference(scenario: Scenario) -> float:
    """Return the stationary RMS of the norm of the tracking error that no causal controller can beat, m.

    Args:
        scenario: Hover in fluctuating or turbulent wind, with white noise, delays and lags; others are a ValueError.
    """
    problem = linear_problem(scenario)
    P, innovation, K, F = _design(problem)
    known = solve_discrete_lyapunov(problem.A - problem.B @ F, K @ innovation @ K.T)
    covariance = known + P - K @ problem.C @ P
    return float(np.sqrt(np.trace(problem.error @ covariance @ problem.error.T)))
