"""The reference over the horizon of a model-predictive controller, extrapolated by its Taylor polynomial of order 6."""

from math import factorial
from typing import NamedTuple

import numpy as np

from quadpend_baselines.estimation.estimate import Estimate
from quadpend_baselines.modelling.equivalent import equivalent_model
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import COMMAND_SIZE, STATE_SIZE


class Horizon(NamedTuple):
    """The reference of n rows at the periods 0 … H of the horizon."""

    state: Floats  # x_d, position and velocity relative to the reference, shape (H + 1, n, 18)
    command: Floats  # u_d, N and N·m, shape (H + 1, n, 4)
    # Motion of the reference frame in each period, to be subtracted from position (m) and velocity (m/s),
    # shape (H, 2, n, 3)
    frame_displacement: Floats


def reference_horizon(estimate: Estimate, simulation: Simulation, period: float, periods: int) -> Horizon:
    """Return the reference of an estimate over `periods` periods (s) of a horizon.

    States and commands follow it under the estimated disturbance, which is taken as constant.
    """
    steps, rows = periods + 1, len(estimate.array)
    time = period * np.arange(steps)
    derivatives = np.moveaxis(estimate.reference, 1, 0)
    future = np.zeros((steps, *derivatives.shape))
    for order in range(len(derivatives)):
        for power in range(len(derivatives) - order):
            factor = time**power / factorial(power)
            future[:, order] += factor[:, np.newaxis, np.newaxis] * derivatives[order + power]
    yaw, rate, acceleration = estimate.yaw.T
    t = time[:, np.newaxis]
    yaws = np.stack(
        np.broadcast_arrays(yaw + t * rate + t**2 / 2 * acceleration, rate + t * acceleration, acceleration), -1
    )
    disturbances = np.tile(estimate.disturbance, (steps, 1))
    orders = np.moveaxis(future, 2, 1).reshape(-1, *estimate.reference.shape[1:])
    state, command = equivalent_model(simulation).trajectory(orders, yaws.reshape(-1, 3), disturbances)
    displacement = [
        sum(period ** (i + order) / factorial(i + order) * future[:-1, i] for i in range(len(derivatives)))
        for order in (2, 1)  # of position, of velocity
    ]
    return Horizon(
        state.reshape(steps, rows, STATE_SIZE),
        command.reshape(steps, rows, COMMAND_SIZE),
        np.stack(displacement, axis=1),
    )
