"""The planned swing-up, from a file, with the feedback of a time-varying linear-quadratic regulator.

The feedback is `controllers.lqr.varying_gains`: A_k and B_k are central differences of `kernel.advance` along the plan,
and Q, R and P_N are those of `controllers.lqr`, in actions instead of commands. `optimal.swing_up` computes the plan.
"""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadpend_baselines.controllers import lqr
from quadpend_baselines.gains import SwingUpGains
from quadpend_baselines.modelling.linear_model import STATE_COLUMNS
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.kernel import advance
from quadpend_gym.physics.state import ACTION_SIZE, DISTURBANCE_SIZE, STATE_SIZE

PLAN_FILE = Path(__file__).with_name("swing_up.csv")
_STEP = 1e-5  # of the central differences


class TrackedPlan(NamedTuple):
    """A planned flight of N control steps and its feedback.

    Attributes:
        states: x_k, relative to the reference, shape (N + 1, 18).
        actions: a_k, shape (N, 4).
        gains: K_k, shape (N, 4, 18).
    """

    states: Floats
    actions: Floats
    gains: Floats


def read_plan() -> tuple[Floats, Floats]:
    """Return the states, shape (N + 1, 18), and the actions, shape (N, 4), of the plan of the package."""
    numbers = np.loadtxt(PLAN_FILE, delimiter=",", skiprows=1)
    return numbers[:, :STATE_SIZE], numbers[:-1, STATE_SIZE:]


@lru_cache(maxsize=8)
def tracked_plan(gains: SwingUpGains, simulation: Simulation) -> TrackedPlan:
    """Return the plan of the package with its feedback.

    Raises:
        ValueError: If the simulation has other parameters, limits or another control period than that of the plan.
    """
    default = Simulation()
    if simulation.is_rigid or any(
        getattr(simulation, name) != getattr(default, name) for name in ("parameters", "torque_limits", "period")
    ):
        raise ValueError(
            "swing-up has a plan for the paper's vehicle with its default parameters and the control period"
            f" {default.period:g} s only"
        )
    states, actions = read_plan()
    A, B = _linearise(states, actions, simulation)
    Q, R = _expand(lqr.weights(gains.regulator, simulation)[0]), gains.regulator.effort**-2.0 * np.eye(ACTION_SIZE)
    P = _expand(lqr.riccati(gains.regulator, simulation)[1])
    return TrackedPlan(states, actions, lqr.varying_gains(A, B, Q, R, P))


def _expand(matrix: Floats) -> Floats:
    """Return a matrix of the linear model's states, shape (16, 16), for all states; r_z and ṙ_z have no weight."""
    out = np.zeros((STATE_SIZE, STATE_SIZE))
    out[np.ix_(STATE_COLUMNS, STATE_COLUMNS)] = matrix
    return out


def _linearise(states: Floats, actions: Floats, simulation: Simulation) -> tuple[Floats, Floats]:
    """Return the derivatives of the next state along a flight, shapes (N, 18, 18) and (N, 18, 4)."""
    size = STATE_SIZE + ACTION_SIZE
    steps = _STEP * np.concatenate([np.eye(size), -np.eye(size)])
    x = (states[:-1, np.newaxis] + steps[:, :STATE_SIZE]).reshape(-1, STATE_SIZE)
    a = (actions[:, np.newaxis] + steps[:, STATE_SIZE:]).reshape(-1, ACTION_SIZE)
    scale = simulation.command_scale
    command = scale * [1.0, 0.0, 0.0, 0.0] + scale * a
    parameters = np.tile(simulation.parameters.as_array(), (len(x), 1))
    advance(x, command, np.zeros((len(x), DISTURBANCE_SIZE)), parameters, simulation.period, simulation.substeps)
    plus, minus = np.split(x.reshape(len(actions), 2 * size, STATE_SIZE), 2, axis=1)
    jacobian = np.swapaxes(plus - minus, 1, 2) / (2.0 * _STEP)
    return jacobian[..., :STATE_SIZE], jacobian[..., STATE_SIZE:]
