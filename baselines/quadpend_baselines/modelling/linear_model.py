"""Linear model: the simulation over one control period, linearised at hover with the pendulum upright.

    (1)  x_{k+1} = A x_k + B u_k + E d_k

All vectors are deviations from hover at ψ = 0. The model leaves out r_z and ṙ_z, which are constant to first order.

| vector | components                                                       | unit                      |
|--------|------------------------------------------------------------------|---------------------------|
| x      | ζ (3), ζ̇ (3), φ θ ψ, φ̇ θ̇ ψ̇, r_x r_y, ṙ_x ṙ_y                        | m, m/s, rad, rad/s, 1, 1/s |
| u      | thrust, τφ, τθ, τψ                                               | N, N·m                    |
| d      | force on the quadrotor (3), on the bob (x, y), torque (3)        | N, N·m                    |

The model leaves out the vertical force on the bob because measurements cannot distinguish it from a vertical force on
the quadrotor.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.modelling.quantities import VehicleState, turn3
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.plants import plant_of
from quadpend_gym.physics.rigid_kernel import ROTOR_THRUST
from quadpend_gym.physics.state import (
    ACTION_SIZE,
    BOB_FORCE,
    COMMAND_SIZE,
    DIRECTION,
    DIRECTION_RATE,
    DISTURBANCE_SIZE,
    FORCE,
    STATE_SIZE,
    THRUST,
    TORQUE,
    State,
)
from quadpend_gym.physics.vectors import Vec3, load

# x: r_z and ṙ_z are left out of the state.
STATE_COLUMNS = np.r_[0 : DIRECTION + 2, DIRECTION_RATE : DIRECTION_RATE + 2]
MODEL_STATE_SIZE = STATE_COLUMNS.size
POSITION, VELOCITY, EULER, EULER_RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
PENDULUM, PENDULUM_RATE = slice(12, 14), slice(14, 16)  # r_x r_y, ṙ_x ṙ_y
# d: the vertical force on the bob is left out of the disturbance.
DISTURBANCE_COLUMNS = np.r_[FORCE : FORCE + 3, BOB_FORCE : BOB_FORCE + 2, TORQUE : TORQUE + 3]
MODEL_DISTURBANCE_SIZE = DISTURBANCE_COLUMNS.size
MODEL_FORCE, MODEL_BOB_FORCE, MODEL_TORQUE = slice(0, 3), slice(3, 5), slice(5, 8)
_STEP = 1e-4  # of the central differences; their error is of order 1e-8


class LinearModel(NamedTuple):
    """A, B and E of equation (1), shapes (16, 16), (16, 4) and (16, 8), or with 20 states of a rigid vehicle."""

    transition: Floats
    input: Floats
    disturbance: Floats


def jacobian(function: Callable[[Floats], Floats], points: Floats) -> Floats:
    """Return the derivatives of a function at n points, shape (n, m, k), by central differences.

    Every linear model of a flight is made here. The function takes any number of points as rows of k numbers, and
    returns rows of m numbers.
    """
    rows, size = points.shape
    steps = _STEP * np.concatenate([np.eye(size), -np.eye(size)])
    values = function((points[:, np.newaxis] + steps).reshape(-1, size))
    plus, minus = np.split(values.reshape(rows, 2 * size, -1), 2, axis=1)
    return np.swapaxes((plus - minus) / (2.0 * _STEP), 1, 2)


def linearise(simulation: Simulation) -> LinearModel:
    """Return the model (1) over one control period.

    The model of a rigid vehicle is that of `RigidPlant.advance` without the lag of the rotors and without
    latency; the torques of u are about the axes of the body, d_τ is in the world frame, and pivot and drag are those
    of the vehicle.
    """
    hover = simulation.parameters.hover_thrust * np.eye(COMMAND_SIZE)[THRUST]

    def moved(x: Floats, command: Floats, disturbance: Floats) -> Floats:
        state, *given = _at_hover(x, disturbance, simulation)
        plant_of(simulation).advance_under(hover + command, state, *given)
        return state[:, STATE_COLUMNS]

    return _model(moved, MODEL_STATE_SIZE, COMMAND_SIZE)


def linearise_actions(simulation: Simulation) -> LinearModel:
    """Return the model (1) with actions in place of u, at once, with the rate loop and the lag of the rotors.

    For a rigid vehicle the thrusts of the rotors follow x; without rotors these are thrust and torques.
    """
    plant = plant_of(simulation)

    def moved(x: Floats, action: Floats, disturbance: Floats) -> Floats:
        state, *given = _at_hover(x, disturbance, simulation)
        memory = plant.initial_memory(state)
        memory[:, ROTOR_THRUST:] += x[:, MODEL_STATE_SIZE:]
        plant.advance(state, memory, action, *given)
        return np.hstack([state[:, STATE_COLUMNS], memory[:, ROTOR_THRUST:]])

    return _model(moved, MODEL_STATE_SIZE + (ACTION_SIZE if plant.memory_size else 0), ACTION_SIZE)


def _at_hover(x: Floats, model_disturbance: Floats, simulation: Simulation) -> tuple[Floats, Floats, Floats]:
    """Return the states, disturbances and parameters of deviations from hover."""
    state, disturbance = np.zeros((len(x), STATE_SIZE)), np.zeros((len(x), DISTURBANCE_SIZE))
    State(state).direction[:, 2] = 1.0
    state[:, STATE_COLUMNS] += x[:, :MODEL_STATE_SIZE]
    disturbance[:, DISTURBANCE_COLUMNS] = model_disturbance
    return state, disturbance, np.tile(simulation.parameters.as_array(), (len(x), 1))


def _model(moved: Callable[[Floats, Floats, Floats], Floats], states: int, inputs: int) -> LinearModel:
    """Return the model (1) of x after a control period as a function of x, u and d."""
    ends = states, states + inputs
    point = np.zeros((1, states + inputs + MODEL_DISTURBANCE_SIZE))
    slopes = jacobian(lambda points: moved(*map(np.ascontiguousarray, np.split(points, ends, axis=1))), point)[0]
    return LinearModel(*np.split(slopes, ends, axis=1))


def rotate_state(x: Floats, yaw: Floats) -> Floats:
    """Rotate the horizontal world-frame vectors of x, shape (n, 16), about the vertical by `yaw`, rad, shape (n,).

    Attitude angles and their rates stay the same.
    """
    return rotate(x, yaw, POSITION.start, VELOCITY.start, PENDULUM.start, PENDULUM_RATE.start)


@inlined
def model_state(s: VehicleState, sine: float, cosine: float) -> tuple[float, ...]:
    """Return x of a deviation of states, rotated about the vertical by an angle with this sine and cosine."""
    position, velocity = turn3(s.position, sine, cosine), turn3(s.velocity, sine, cosine)
    r, r_dot = turn3(s.direction, sine, cosine), turn3(s.direction_rate, sine, cosine)
    angle, rate = s.euler, s.euler_rate
    return (
        position.x,
        position.y,
        position.z,
        velocity.x,
        velocity.y,
        velocity.z,
        angle.x,
        angle.y,
        angle.z,
        rate.x,
        rate.y,
        rate.z,
        r.x,
        r.y,
        r_dot.x,
        r_dot.y,
    )


@inlined
def state_of_model(x: Any, sine: float, cosine: float) -> VehicleState:
    """Return the deviation of states for x in an array, shape (16, 1): the inverse of `model_state`."""
    r, r_dot = Vec3(x[12, 0], x[13, 0], 0.0), Vec3(x[14, 0], x[15, 0], 0.0)
    return VehicleState(
        turn3(load(x, 0, 0), sine, cosine),
        turn3(load(x, 3, 0), sine, cosine),
        load(x, 6, 0),
        load(x, 9, 0),
        turn3(r, sine, cosine),
        turn3(r_dot, sine, cosine),
    )


def rotate(rows: Floats, yaw: Floats, *columns: int) -> Floats:
    """Return a copy of rows, shape (n, k), with some horizontal vectors rotated about the vertical by `yaw`, rad, (n,).

    `columns` are those of the x components; the y component of each vector is in the next column.
    """
    cosine, sine = np.cos(yaw), np.sin(yaw)
    out = rows.copy()
    for column in columns:
        x, y = rows[:, column], rows[:, column + 1]
        out[:, column], out[:, column + 1] = cosine * x - sine * y, sine * x + cosine * y
    return out


def limit_norm(vector: Floats, limit: float) -> Floats:
    """Return vectors, shape (n, k), scaled down so that no norm exceeds `limit`."""
    norm = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.asarray(vector * (limit / np.maximum(norm, limit)))
