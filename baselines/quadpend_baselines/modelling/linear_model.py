"""The environment's own kernel, linearised where quadrotor and pendulum hover upright.

    (1)  x_{k+1} = A x_k + B u_k + E d_k

in deviations from hover at ψ = 0. r_z and ṙ_z do not appear: to first order they are 1 and 0.

| vector | components                                                       | unit                      |
|--------|------------------------------------------------------------------|---------------------------|
| x      | ζ (3), ζ̇ (3), φ θ ψ, φ̇ θ̇ ψ̇, r_x r_y, ṙ_x ṙ_y                        | m, m/s, rad, rad/s, 1, 1/s |
| u      | thrust, τφ, τθ, τψ                                               | N, N·m                    |
| d      | force on the quadrotor (3), on the bob (x, y), torque (3)        | N, N·m                    |

The bob's vertical force is left out: it cannot be told from the quadrotor's.
"""

from typing import NamedTuple

import numpy as np

from quadpend_baselines.modelling.planar import rotate
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import COMMAND_SIZE, DIRECTION, DIRECTION_RATE, DISTURBANCE_SIZE, STATE_SIZE

STATE_COLUMNS = np.r_[0:14, DIRECTION_RATE, DIRECTION_RATE + 1]  # of the state that x has
DISTURBANCE_COLUMNS = np.r_[0:5, 6:9]  # of the nine disturbances that d has
POSITION, VELOCITY, EULER, EULER_RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
PENDULUM, PENDULUM_RATE = slice(12, 14), slice(14, 16)
MODEL_STATE_SIZE = STATE_COLUMNS.size
_STEP = 1e-4  # of the central differences: their error is of order 1e-8


class LinearModel(NamedTuple):
    """A, B and E of equation (1), shapes (16, 16), (16, 4) and (16, 8)."""

    transition: Floats
    input: Floats
    disturbance: Floats


def linearise(simulation: Simulation) -> LinearModel:
    """Equation (1) over one control period, by central differences of `kernel.advance`."""
    sizes = (MODEL_STATE_SIZE, COMMAND_SIZE, DISTURBANCE_COLUMNS.size)
    steps = _STEP * np.concatenate([np.eye(sum(sizes)), -np.eye(sum(sizes))])
    x, command, forces = np.split(steps, np.cumsum(sizes)[:-1], axis=1)
    state = np.zeros((len(steps), STATE_SIZE))
    state[:, DIRECTION + 2] = 1.0
    state[:, STATE_COLUMNS] += x
    command[:, 0] += simulation.parameters.hover_thrust
    disturbance = np.zeros((len(steps), DISTURBANCE_SIZE))
    disturbance[:, DISTURBANCE_COLUMNS] = forces
    parameters = np.tile(simulation.parameters.as_array(), (len(steps), 1))
    advance(state, command, disturbance, parameters, simulation.period, simulation.substeps)
    plus, minus = np.split(state[:, STATE_COLUMNS], 2)
    jacobian = ((plus - minus) / (2.0 * _STEP)).T
    return LinearModel(*np.split(jacobian, np.cumsum(sizes)[:-1], axis=1))


def rotate_state(x: Floats, yaw: Floats) -> Floats:
    """Turn the world's vectors in rows of x, shape (n, 16), about the vertical by angles (n,): attitudes stay."""
    return rotate(x, yaw, POSITION.start, VELOCITY.start, PENDULUM.start, PENDULUM_RATE.start)
