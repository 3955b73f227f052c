"""The linear model of the loop that flies, at hover with the pendulum on its side, and the margins of a policy in it.

    (1)  x_{k+1} = A x_k + B u_k,   (e_k, y_k) = C x_k + D u_k

`vehicle_model` returns (1) as a discrete `control.StateSpace`, with the control period, from the exact derivatives of
the environment's step (`quadpend_gym.engines`). The components of its signals have names such as ``force[0]``:

| vector | name                    | size | unit and frame                                                            |
|--------|-------------------------|------|---------------------------------------------------------------------------|
| u      | force, bob_force        | 3, 3 | N, world, on the quadrotor and on the bob                                 |
|        | torque                  | 3    | N·m, world; paper's vehicle: φ, θ, ψ axes                                 |
|        | air_velocity            | 3    | m/s, world                                                                |
|        | noise_NAME              |      | as y, added to the component NAME of y                                    |
|        | action                  | 4    | of the policy, 1                                                          |
| e      | tracking_error          | 3    | m, as in the observation and the score                                    |
| y      | position, velocity      | 3, 3 | m, m/s, world; the velocity is not measured in output feedback            |
|        | attitude, rate          | 3, 3 | rad, rad/s, roll, pitch, yaw; the rate is not measured in output feedback |
|        | pendulum, pendulum_rate | 2, 2 | 1, 1/s, r_x r_y and ṙ_x ṙ_y; the rate is not measured in output feedback  |
| x      | those of y              | 16   | at the time of the step                                                   |
|        | rotor_thrust            | 4    | rigid vehicles: N; without rotors, thrust and torques (N, N·m)            |
|        | latency_I               | 4    | 1, actions under way of the vehicle's latency, the oldest (I = 1) first   |
|        | action_delay_I, lag     | 4    | 1, of `ActionDelay` and `MotorLag`                                        |
|        | sensor_delay_I_NAME     |      | as y, the measurements under way, the oldest first                        |

Small deviations pass rate limits, packet losses, dropouts and sensors with a slower sampling unchanged. Everything is a
deviation from hover at ψ = 0 in still air, so the quadratic drag is left out. The extra `control` is needed.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.linalg import eigvals
from scipy.optimize import brentq

from quadpend_baselines.modelling.linear_model import EULER, EULER_RATE, MODEL_STATE_SIZE, STATE_COLUMNS
from quadpend_baselines.policy.protocol import Policy
from quadpend_gym import Simulation, engines
from quadpend_gym.actuators import ActionDelay, MotorLag, Rotors, mixing
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.rigid_kernel import BODY_RATE, QUATERNION, ROTOR_THRUST
from quadpend_gym.physics.state import ACTION_SIZE, STATE_SIZE, State
from quadpend_gym.scenarios import Scenario
from quadpend_gym.sensors import Delay
from quadpend_gym.tasks.observation import OBSERVATION_SIZE, OUTPUT_FEEDBACK_COLUMNS
from quadpend_gym.wind import WIND_SIZE

_STATE_NAMES = {"position": 3, "velocity": 3, "attitude": 3, "rate": 3, "pendulum": 2, "pendulum_rate": 2}
_RATES = ("velocity", "rate", "pendulum_rate")
_STEPS = 2.0**-12, 2.0**-14  # of the differences of a policy; exact in float32
_SETTLED = 150  # control steps at hover after which the memory of a policy is at rest
_LINEAR = 1e-3  # largest relative change of the differences with their step
_ROUNDING = 1e-9  # of the differences
_FREQUENCIES = 400  # of the grid on which the margins are searched


def _names(**sizes: int) -> list[str]:
    return [f"{name}[{i}]" for name, size in sizes.items() for i in range(size)]


def _measured(scenario: Scenario) -> dict[str, int]:
    return {name: size for name, size in _STATE_NAMES.items() if not (scenario.output_feedback and name in _RATES)}


def _hover(side: float) -> Floats:
    state = np.zeros((1, STATE_SIZE))
    State(state).direction[:, 2] = side
    return state


@lru_cache(maxsize=32)
def _jacobians(simulation: Simulation, side: float) -> tuple[Floats, Floats, Floats]:
    """Return A, B of the action and B of the wind, with the latency of the simulation."""
    step = engines.step_function(simulation)
    results, arguments = ("next_state", "next_memory"), ("state", "memory", "action", "wind")
    jacobian = step.factory("jacobian", step.name_in(), [f"jac:{f}:{x}" for f in results for x in arguments])
    state, none = _hover(side), (np.zeros(ACTION_SIZE), np.zeros(WIND_SIZE))
    memory = engines.initial_memory(simulation, state)
    blocks = [block.full() for block in jacobian.call([state[0], memory[0], *none, simulation.parameters.as_array()])]
    full = np.vstack([np.hstack(blocks[:4]), np.hstack(blocks[4:])])
    # From x to state and memory, and back. Attitude and body rate of a rigid vehicle stand in its memory.
    is_rigid = simulation.vehicle.attitude == "rigid"
    rest = STATE_SIZE + (ROTOR_THRUST if is_rigid else 0)
    size = STATE_SIZE + memory.shape[1]
    back = np.eye(size)[np.r_[STATE_COLUMNS, rest:size]]
    embed = back.T.copy()
    if is_rigid:
        first = STATE_SIZE + QUATERNION + 1
        embed[first : first + 3, EULER] = 0.5 * np.eye(3)
        first = STATE_SIZE + BODY_RATE
        embed[first : first + 3, EULER_RATE] = np.eye(3)
    A, B = back @ full[:, :size] @ embed, back @ full[:, size:]
    return A, B[:, :ACTION_SIZE], B[:, ACTION_SIZE:]


def _gain(matrix: Floats, period: float) -> Any:
    return control.ss([], [], [], matrix, period)


def _register(steps: int, size: int, period: float) -> Any:
    """Return a delay by a number of control steps; its state has the oldest values first."""
    length = steps * size
    return control.ss(np.eye(length, k=size), np.eye(length)[:, length - size :], np.eye(size, length), 0.0, period)


def _actuators(scenario: Scenario) -> tuple[Any, list[str]]:
    """Return the model from the actions of the policy to those of the vehicle, and the names of its states."""
    period, names, delays = scenario.period, [], 0
    system = _gain(np.eye(ACTION_SIZE), period)
    for model in scenario.actuators:
        if isinstance(model, ActionDelay):
            system = _register(model.steps, ACTION_SIZE, period) * system
            names += _names(**{f"action_delay_{delays + i + 1}": ACTION_SIZE for i in range(model.steps)})
            delays += model.steps
        elif isinstance(model, MotorLag):
            ratio, one = period / model.time_constant, np.eye(ACTION_SIZE)
            left, mean = np.exp(-ratio), -np.expm1(-ratio) / ratio
            system = control.ss(left * one, (1.0 - left) * one, mean * one, (1.0 - mean) * one, period) * system
            names += _names(lag=ACTION_SIZE)
        elif isinstance(model, Rotors):
            system = _gain(mixing(model, scenario.simulation), period) * system
    return system, names


def vehicle_model(scenario: Scenario) -> Any:
    """Return the model (1) of a scenario: its vehicle, interface, latency, actuators and sensors at hover."""
    side, period, measured = scenario.task.side, scenario.period, _measured(scenario)
    A, B_action, B_wind = _jacobians(scenario.simulation, side)
    observe = engines.observation_function()
    slope = observe.factory("slope", observe.name_in(), ["jac:tracking_error:state"])
    point = np.zeros(observe.numel_in("point"))
    error = slope(_hover(side)[0], scenario.simulation.parameters.as_array(), point).full()[:, STATE_COLUMNS]
    outputs = np.zeros((3 + sum(measured.values()), len(A)))
    outputs[:3, :MODEL_STATE_SIZE] = error
    all_names = _names(**_STATE_NAMES)
    outputs[3:, :MODEL_STATE_SIZE] = np.eye(MODEL_STATE_SIZE)[[name in _names(**measured) for name in all_names]]
    system = control.ss(A, np.hstack([B_wind, B_action]), outputs, 0.0, period)
    names = all_names + (_names(rotor_thrust=4) if scenario.vehicle.attitude == "rigid" else [])
    latency = (len(A) - len(names)) // ACTION_SIZE
    names += _names(**{f"latency_{i + 1}": ACTION_SIZE for i in range(latency)})
    actuators, actuator_names = _actuators(scenario)
    system, names = system * control.append(_gain(np.eye(WIND_SIZE), period), actuators), actuator_names + names
    if steps := sum(model.steps for model in scenario.sensors if isinstance(model, Delay)):
        register = _register(steps, sum(measured.values()), period)
        system = control.append(_gain(np.eye(3), period), register) * system
        names += _names(**{f"sensor_delay_{i + 1}_{name}": measured[name] for i in range(steps) for name in measured})
    noise = np.eye(system.noutputs)[:, 3:]
    return control.ss(
        system.A,
        np.insert(system.B, [WIND_SIZE] * noise.shape[1], 0.0, axis=1),
        system.C,
        np.insert(system.D, WIND_SIZE, noise.T, axis=1),
        period,
        states=names,
        inputs=[
            *_names(force=3, bob_force=3, torque=3, air_velocity=3),
            *_names(**{f"noise_{name}": size for name, size in measured.items()}, action=ACTION_SIZE),
        ],
        outputs=_names(tracking_error=3, **measured),
        name="vehicle",
    )


def close_loop(vehicle: Any, policy: Any) -> Any:
    """Return the closed loop from wind and noise to the tracking error, a `control.StateSpace`.

    Args:
        vehicle: A model whose last inputs are the actions and whose last outputs are the measurements.
        policy: The linear policy from the measurements to the actions, a `control.StateSpace`.
    """
    inputs, outputs = vehicle.ninputs - policy.noutputs, vehicle.noutputs - policy.ninputs
    closed = vehicle.lft(policy)
    labels = vehicle.input_labels[:inputs], vehicle.output_labels[:outputs]
    return control.ss(closed, inputs=labels[0], outputs=labels[1], name="closed_loop")


class Margins(NamedTuple):
    """How much one common change of all actions the loop tolerates; 0 if the loop is unstable without a change."""

    growth: float  # largest magnitude of a pole of the closed loop, which is unstable from 1 on
    delay: float  # s
    phase: float  # rad
    gain: tuple[float, float]  # smallest and largest factor
    sensitivity: float  # peak of the largest singular value of (1 + L)⁻¹ at the actions


def margins(vehicle: Any, policy: Any) -> Margins:
    """Return the margins of a loop, see `close_loop` for the arguments.

    At an eigenvalue λ of the loop L(e^{jωT}) with |λ| = 1, a phase lag arg(−λ) or a delay arg(−λ)/ω at all actions
    leads to oscillations. A delay that is no whole number of periods differs from e^{−jωτ} by O((ωT)²), since actions
    are held: it is 1.1 times as large for `flatness` on the paper's vehicle.
    """
    actions, measurements, period = policy.noutputs, policy.ninputs, float(vehicle.dt)
    B, C = vehicle.B[:, -actions:], vehicle.C[-measurements:]

    def growth(gain: float) -> float:
        A = [[vehicle.A + gain * B @ policy.D @ C, gain * B @ policy.C], [policy.B @ C, policy.A]]
        return float(np.abs(eigvals(np.block(A))).max())

    loop = -policy * control.ss(vehicle.A, B, C, 0.0, vehicle.dt)

    def loci(frequency: float) -> Any:
        found = eigvals(loop(np.exp(1j * frequency * period), squeeze=False))
        return found[np.argsort(np.abs(found))]

    largest, frequencies = growth(1.0), np.pi / period * np.geomspace(1e-4, 1.0, _FREQUENCIES)
    response = loop(np.exp(1j * frequencies * period), squeeze=False).transpose(2, 0, 1)
    sensitivity = 1.0 / np.linalg.svd(np.eye(actions) + response, compute_uv=False).min()
    if largest >= 1.0:
        return Margins(largest, 0.0, 0.0, (1.0, 1.0), float(sensitivity))
    sizes = np.log(np.sort(np.abs(eigvals(response)), axis=1))
    delay, phase = np.inf, np.pi
    for k, locus in zip(*np.nonzero(np.diff(np.sign(sizes), axis=0)), strict=True):
        ends = frequencies[k : k + 2]
        crossing = brentq(lambda w, locus=locus: np.log(np.abs(loci(w)[locus])), *ends)
        lag = float(np.angle(-loci(crossing)[locus]))
        delay, phase = min(delay, lag % (2.0 * np.pi) / crossing), min(phase, abs(lag))
    lower, upper = (_first(growth, np.geomspace(1.0, limit, 60)) for limit in (1e-3, 1e3))
    return Margins(largest, delay, phase, (lower if lower > 1e-3 else 0.0, upper), float(sensitivity))


def _first(growth: Callable[[float], float], gains: Floats) -> float:
    """Return the first gain at which the loop is unstable; infinity, or 0 below 1, if it is stable at all of them."""
    for before, after in pairwise(gains):
        if growth(after) >= 1.0:
            return float(brentq(lambda gain: growth(gain) - 1.0, before, after, rtol=1e-6))
    return np.inf if gains[-1] > 1.0 else 0.0


def linear_policy(policy: Policy, scenario: Scenario) -> Any:
    """Return the linear model of a policy from the measurements to the actions, a `control.StateSpace`; None: none.

    It is the central difference of `predict` and of the memory that it returns, at the memory after 1.5 s at hover. A
    policy has no linear model if the difference depends on its step, for example because of a sign or a random number.

    Args:
        policy: The policy, already adapted to the scenario.
        scenario: Defines what is measured.
    """
    observe = engines.observation_function()
    jacobian = observe.factory("slope", observe.name_in(), ["observation", "jac:observation:state"])
    point, parameters = np.zeros(observe.numel_in("point")), scenario.simulation.parameters.as_array()
    hover, slope = (value.full() for value in jacobian(_hover(scenario.task.side)[0], parameters, point))
    visible = [name in _names(**_measured(scenario)) for name in _names(**_STATE_NAMES)]
    columns = OUTPUT_FEEDBACK_COLUMNS if scenario.output_feedback else np.arange(OBSERVATION_SIZE)
    rest, slope = hover[columns, 0], slope[np.ix_(columns, STATE_COLUMNS[visible])]
    memory = None
    for step in range(_SETTLED):
        _, memory = policy.predict(rest[np.newaxis].astype(np.float32), memory, np.array([step == 0]))
    values, measurements = _flatten(memory), slope.shape[1]
    is_state = np.isfinite(values[0])
    differences = []
    for size in _STEPS:
        change = size * np.vstack([np.eye(measurements + is_state.sum()), -np.eye(measurements + is_state.sum())])
        observation = (rest + change[:, :measurements] @ slope.T).astype(np.float32)
        rows = np.repeat(values, len(change), axis=0)
        rows[:, is_state] += change[:, measurements:]
        action, after = policy.predict(
            observation, _rebuild(memory, iter(rows.T), len(rows)), np.zeros(len(change), np.bool_)
        )
        plus, minus = np.split(np.hstack([action, _flatten(after)[:, is_state]]), 2)
        differences.append((plus - minus).T / (2.0 * size))
    coarse, fine = differences
    if not (np.abs(coarse - fine) <= _LINEAR * np.abs(fine).max(axis=1, keepdims=True) + _ROUNDING).all():
        return None
    fine[np.abs(fine) < _ROUNDING] = 0.0
    D, B = np.split(fine[:, :measurements], [ACTION_SIZE])
    C, A = np.split(fine[:, measurements:], [ACTION_SIZE])
    # What the measurements cannot change, such as constants, and what the actions do not depend on, is left out.
    used = _linked(A, B.any(axis=1)) & _linked(A.T, C.any(axis=0))
    A, B, C = A[np.ix_(used, used)], B[used], C[:, used]
    return control.ss(A, B, C, D, scenario.period, inputs=_names(**_measured(scenario)), outputs=_names(action=4))


def _linked(A: Floats, states: Any) -> Any:
    """Return the states that A connects to some states in any number of steps, as masks of shape (n,)."""
    for _ in A:
        states = states | A[:, states].any(axis=1)
    return states


def _leaves(memory: Any) -> Iterator[Any]:
    if isinstance(memory, tuple):
        for part in memory:
            yield from _leaves(part)
    elif memory is not None:
        yield memory


def _flatten(memory: Any) -> Floats:
    """Return the numbers of a memory of n rows, shape (n, k); the whole numbers in it, such as ages, are not states."""
    leaves = [np.asarray(leaf) for leaf in _leaves(memory)]
    return np.hstack([np.asarray(x, np.float64).reshape(len(x), -1) for x in leaves if x.dtype.kind == "f"])


def _rebuild(memory: Any, columns: Iterator[Floats], rows: int) -> Any:
    """Return a memory of n rows, like `memory` with its one row, with the numbers of `columns`, each of shape (n,)."""
    if isinstance(memory, tuple):
        parts = [_rebuild(part, columns, rows) for part in memory]
        return type(memory)(*parts) if hasattr(memory, "_fields") else tuple(parts)
    if memory is None:
        return None
    array = np.repeat(memory, rows, axis=0)
    if array.dtype.kind == "f":
        for index in np.ndindex(array.shape[1:]):
            array[(slice(None), *index)] = next(columns)
    return array
