"""The linear model of the loop that flies, at hover with the pendulum on its side, and the margins of a policy in it.

    (1)  x_{k+1} = A x_k + B u_k,   (e_k, y_k) = C x_k + D u_k

`vehicle_model` returns (1) as a discrete `control.StateSpace`, with the control period, from differences of the
environment's step (`quadpend_gym.engines`). Its signals have names such as ``force[0]`` (docs/linear-model.md):
u is wind, noise and actions, e the tracking error, y the measurements, and x the vehicle with everything under way.

Rate limits do not act on small deviations; random losses of commands and samples are left out. Everything is a
deviation from hover at ψ = 0 in still air, so the quadratic drag is left out. The extra `control` is needed.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.linalg import eigvals
from scipy.optimize import brentq

from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE, STATE_COLUMNS, jacobian
from quadpend_baselines.policy.protocol import select_rows
from quadpend_gym import Simulation, engines
from quadpend_gym.actuators import ActionDelay, MotorLag, lag_shares
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE, State
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Delay, SampleHold
from quadpend_gym.tasks.observation import ALL
from quadpend_gym.wind import WIND_SIZE

_STEPS = 2.0**-12, 2.0**-14  # of the differences of a policy; exact in float32
_SETTLED = 150  # control steps at hover after which the memory of a policy must be at rest
_AT_REST = 1e-3  # largest action at hover
_LINEAR = 1e-3  # largest relative change of the differences with their step
_ROUNDING = 1e-9  # of the differences
_FREQUENCIES = 400  # of the grid on which the margins are searched


def _names(**sizes: int) -> list[str]:
    return [f"{name}[{i}]" for name, size in sizes.items() for i in range(size)]


_STATES = _names(position=3, velocity=3, attitude=3, rate=3, pendulum=2, pendulum_rate=2)


def _measured(scenario: Scenario) -> list[str]:
    _, slope = _observed("observation", scenario)
    used = slope[ALL.select(scenario.observation)].any(axis=0)
    return [name for name, is_used in zip(_STATES, used, strict=True) if is_used]


def _at_hover(x: Floats, side: float) -> Floats:
    """Return the states for deviations x from hover, shapes (n, 18) and (n, 16)."""
    state = np.zeros((len(x), STATE_SIZE))
    State(state).direction[:, 2] = side
    state[:, STATE_COLUMNS] += x
    return state


def _observed(name: str, scenario: Scenario) -> tuple[Floats, Floats]:
    """Return a result of the observation at hover and its derivative with respect to x, shapes (k,) and (k, 16)."""
    observe, parameters = engines.observation_function(), scenario.simulation.parameters.as_array()
    point = np.zeros(observe.numel_in("point"))

    def observed(x: Floats) -> Floats:
        out = observe(state=_at_hover(x, scenario.task.side).T, parameters=parameters, point=point)[name]
        return np.asarray(out.full().T)

    hover = np.zeros((1, MODEL_STATE_SIZE))
    return observed(hover)[0], jacobian(observed, hover)[0]


@lru_cache(maxsize=32)
def _jacobians(simulation: Simulation, side: float) -> tuple[Floats, Floats, Floats]:
    """Return A, B of the action and B of the wind, with the latency of the simulation."""
    step, parameters = engines.step_function(simulation), simulation.parameters.as_array()
    # Attitude and body rate of a rigid vehicle stand in its memory, too.
    first = ROTOR_THRUST if simulation.vehicle.attitude == "rigid" else 0
    states = MODEL_STATE_SIZE + step.size1_in("memory") - first

    def moved(points: Floats) -> Floats:
        x, action, wind = np.split(points, [states, states + ACTION_SIZE], axis=1)
        state = _at_hover(x[:, :MODEL_STATE_SIZE], side)
        memory = engines.initial_memory(simulation, state)
        memory[:, first:] += x[:, MODEL_STATE_SIZE:]
        following, after = (part.full().T for part in step(state.T, memory.T, action.T, wind.T, parameters))
        return np.hstack([following[:, STATE_COLUMNS], after[:, first:]])

    blocks = np.split(jacobian(moved, np.zeros((1, states + ACTION_SIZE + WIND_SIZE)))[0], [states, states + 4], axis=1)
    return blocks[0], blocks[1], blocks[2]


def _register(steps: int, size: int, period: float) -> Any:
    """Return a delay by a number of control steps, also none; its state has the oldest values first."""
    length = steps * size
    B, D = np.eye(length, size, k=size - length), np.eye(size) * (steps == 0)
    return control.ss(np.eye(length, k=size), B, np.eye(size, length), D, period)


def vehicle_model(scenario: Scenario) -> Any:
    """Return the model (1) of a scenario: its vehicle, interface, latency, actuators and sensors at hover.

    A delay of the actions by whole control steps adds to the latency, since delays and lags commute.
    """
    if is_slower(scenario):
        raise ValueError("a sensor that is slower than the control loop has no linear model of one control period")
    period, measured, one = scenario.period, _measured(scenario), np.eye(ACTION_SIZE)
    actuators, names = _register(0, ACTION_SIZE, period), []
    for model in scenario.actuators:
        if isinstance(model, MotorLag):
            mean, left = lag_shares(period / model.time_constant)
            actuators = control.ss(left * one, (1.0 - left) * one, mean * one, (1.0 - mean) * one, period) * actuators
            names += _names(lag=ACTION_SIZE)
    late = period * sum(model.steps for model in scenario.actuators if isinstance(model, ActionDelay))
    simulation = replace(scenario.simulation, latency=scenario.simulation.latency + late)
    A, B_action, B_wind = _jacobians(simulation, scenario.task.side)
    C = np.vstack([_observed("tracking_error", scenario)[1], np.eye(MODEL_STATE_SIZE)[np.isin(_STATES, measured)]])
    C = np.pad(C, ((0, 0), (0, len(A) - MODEL_STATE_SIZE)))
    system = control.ss(A, np.hstack([B_wind, B_action]), C, 0.0, period)
    system = system * control.append(_register(0, WIND_SIZE, period), actuators)
    own = _STATES + (_names(rotor_thrust=4) if scenario.vehicle.attitude == "rigid" else [])
    names += own + _names(**{f"latency_{i + 1}": ACTION_SIZE for i in range((len(A) - len(own)) // ACTION_SIZE)})
    steps = sum(model.steps for model in scenario.sensors if isinstance(model, Delay))
    system = control.append(_register(0, 3, period), _register(steps, len(measured), period)) * system
    names += [f"sensor_delay_{i + 1}_{name}" for i in range(steps) for name in measured]
    columns, noise = [WIND_SIZE] * len(measured), np.eye(system.noutputs)[:, 3:]  # noise stands before the actions
    B, D = np.insert(system.B, columns, 0.0, axis=1), np.insert(system.D, columns, noise, axis=1)
    inputs = _names(force=3, bob_force=3, torque=3, air_velocity=3) + [f"noise_{name}" for name in measured]
    labels = {"states": names, "inputs": inputs + _names(action=ACTION_SIZE)}
    return control.ss(system.A, B, system.C, D, period, **labels, outputs=_names(tracking_error=3) + measured)


def is_slower(scenario: Scenario) -> bool:
    """Return whether a sensor of a scenario has no new sample at every control step."""
    return any(isinstance(model, SampleHold) and model.steps(scenario.period) > 1 for model in scenario.sensors)


def close_loop(vehicle: Any, policy: Any) -> Any:
    """Return the closed loop from wind and noise to the tracking error, a `control.StateSpace`.

    Args:
        vehicle: A model whose last inputs are the actions and whose last outputs are the measurements.
        policy: The linear policy from the measurements to the actions, a `control.StateSpace`.
    """
    inputs, outputs = vehicle.input_labels[: -policy.noutputs], vehicle.output_labels[: -policy.ninputs]
    return control.ss(vehicle.lft(policy), inputs=inputs, outputs=outputs)


class Margins(NamedTuple):
    """How much one common change of all actions the loop tolerates; 0 if the loop is unstable without a change."""

    spectral_radius: float  # largest magnitude of a pole of the closed loop, which is unstable from 1 on
    delay: float  # s
    phase: float  # smallest lag or lead, rad
    gain: tuple[float, float]  # smallest and largest factor
    sensitivity: float  # peak M_S of the largest singular value of (1 + L)⁻¹ at the actions


def margins(vehicle: Any, policy: Any) -> Margins:
    """Return the margins of a loop, see `close_loop` for the arguments.

    At an eigenvalue λ of the loop L(e^{jωT}) with |λ| = 1, a phase lag arg(−λ) (a lead, if it is negative) or a delay
    arg(−λ)/ω at all actions leads to oscillations. A delay that is no whole number of periods differs from e^{−jωτ} by
    O((ωT)²), since actions are held: it is 1.1 times as large for `flatness` on the paper's vehicle.
    """
    period = float(vehicle.dt)
    plant = vehicle[-policy.ninputs :, -policy.noutputs :]
    loop = -policy * plant

    def growth(gain: float) -> float:
        return float(np.abs(plant.lft(gain * policy).poles()).max())

    def loci(frequencies: Floats) -> tuple[float, Any]:
        """Return the smallest singular value of 1 + L, and the eigenvalues of L by magnitude, shape (n, 4)."""
        response = loop(np.exp(1j * frequencies * period), squeeze=False).transpose(2, 0, 1)
        values = eigvals(response)
        order = np.argsort(np.abs(values), axis=1)
        distance = np.linalg.svd(np.eye(policy.noutputs) + response, compute_uv=False)
        return float(distance.min()), np.take_along_axis(values, order, axis=1)

    largest, frequencies = growth(1.0), np.pi / period * np.geomspace(1e-4, 1.0, _FREQUENCIES)
    distance, values = loci(frequencies)
    if largest >= 1.0:
        return Margins(largest, 0.0, 0.0, (1.0, 1.0), 1.0 / distance)
    sizes = np.log(np.abs(values))
    i, k = np.nonzero(np.diff(np.sign(sizes), axis=0))
    share = sizes[i, k] / (sizes[i, k] - sizes[i + 1, k])
    crossings = frequencies[i] * (frequencies[i + 1] / frequencies[i]) ** share
    lags = np.angle(-loci(crossings)[1][np.arange(len(k)), k]) if len(k) else np.zeros(0)
    delay, phase = (lags % (2.0 * np.pi) / crossings).min(initial=np.inf), np.abs(lags).min(initial=np.pi)
    lower, upper = _first(growth, np.geomspace(1.0, 1e-3, 60)), _first(growth, np.geomspace(1.0, 1e3, 60))
    return Margins(largest, float(delay), float(phase), (lower or 0.0, upper or np.inf), 1.0 / distance)


def _first(growth: Callable[[float], float], gains: Floats) -> float | None:
    """Return the first gain at which the loop is unstable."""
    for before, after in pairwise(gains):
        if growth(after) >= 1.0:
            return float(brentq(lambda gain: growth(gain) - 1.0, before, after, rtol=1e-6))
    return None


def linear_policy(policy: Any, scenario: Scenario) -> Any:
    """Return the linear model of a policy from the measurements to the actions, a `control.StateSpace`; None: none.

    It is the central difference of `predict` and of the memory that it returns, at the memory after 1.5 s at hover. A
    policy has no linear model if it does not stay at hover, such as a network whose action there is not zero, or if the
    difference depends on its step, for example because of a sign or a random number. The memory must be None, an array
    of floats with one row for each observation, or tuples of these, nested to any depth.

    Args:
        policy: The policy, already adapted to the scenario, or any object with its `predict`.
        scenario: Defines what is measured.
    """
    if not getattr(policy, "has_linear_model", True):
        return None
    measured = _measured(scenario)
    rest, slope = _observed("observation", scenario)
    slope = slope[:, np.isin(_STATES, measured)]
    columns = ALL.select(scenario.observation)
    rest, slope = rest[columns], slope[columns]
    memory, count = None, len(measured)
    for step in range(_SETTLED):
        action, memory = policy.predict(rest[np.newaxis].astype(np.float32), memory, np.array([step == 0]))
    if np.abs(action).max() > _AT_REST or not _has_known_form(memory):
        return None
    size = count + sum(part.shape[1] for part in _numbers(memory))
    differences = []
    for step_size in _STEPS:
        change = step_size * np.vstack([np.eye(size), -np.eye(size)])
        observation = (rest + change[:, :count] @ slope.T).astype(np.float32)
        every = np.ones(len(change), np.bool_)
        start = None if memory is None else select_rows(every, memory, memory)
        first = count
        for numbers in _numbers(start):
            numbers += change[:, first : first + numbers.shape[1]]
            first += numbers.shape[1]
        with np.errstate(invalid="ignore"):
            action, after = policy.predict(observation, start, ~every)
        if not np.isfinite(action).all():  # no memory is that far from rest
            return None
        plus, minus = np.split(np.hstack([action, *_numbers(after)], dtype=np.float64), 2)
        differences.append(np.nan_to_num((plus - minus).T / (2.0 * step_size)))
    coarse, fine = differences
    if not (np.abs(coarse - fine) <= _LINEAR * np.abs(fine).max(axis=1, keepdims=True) + _ROUNDING).all():
        return None
    fine[np.abs(fine) < _ROUNDING] = 0.0
    D, B = np.split(fine[:, :count], [ACTION_SIZE])
    C, A = np.split(fine[:, count:], [ACTION_SIZE])
    # What the measurements cannot change, such as constants, and what the actions do not depend on, is left out.
    used = _linked(A, B.any(axis=1)) & _linked(A.T, C.any(axis=0))
    A = A[np.ix_(used, used)]
    return control.ss(A, B[used], C[:, used], D, scenario.period, inputs=measured, outputs=_names(action=4))


def _linked(A: Floats, states: Any) -> Any:
    """Return the states that A connects to some states in any number of steps, as masks of shape (n,)."""
    for _ in A:
        states = states | A[:, states].any(axis=1)
    return states


def _has_known_form(memory: Any) -> bool:
    """Return whether a memory consists of arrays, in tuples of any depth."""
    if isinstance(memory, tuple):
        return all(map(_has_known_form, memory))
    return memory is None or isinstance(memory, np.ndarray)


def _numbers(memory: Any) -> list[Any]:
    """Return views of the floating-point arrays in a memory of n rows, each of shape (n, k)."""
    if isinstance(memory, tuple):
        return [numbers for part in memory for numbers in _numbers(part)]
    is_real = isinstance(memory, np.ndarray) and memory.dtype.kind == "f"
    return [memory.reshape(len(memory), -1)] if is_real else []
