"""The inputs of a policy that observes deviations."""

from typing import Any

import numpy as np

from quadpend_baselines.controllers.lqg import riccati
from quadpend_baselines.hybrid.deviations import DEVIATION_SIZE, deviation_scales
from quadpend_baselines.modelling.linear_model import MODEL_STATE_SIZE, PENDULUM, PENDULUM_RATE, POSITION, VELOCITY
from quadpend_gym.core.arrays import Floats
from quadpend_gym.physics.state import ACTION_SIZE


def linear_feedback(law: Any) -> Floats:
    """Return the matrix from the inputs to the action a_d − F z of `lqg` for a rigid vehicle, shape (36, 4)."""
    gains, parameters = riccati(law.gains, law.simulation)[0].T, law.simulation.parameters
    out = np.zeros((DEVIATION_SIZE, ACTION_SIZE))
    out[:ACTION_SIZE], out[ACTION_SIZE : ACTION_SIZE + len(gains)] = np.eye(ACTION_SIZE), -gains
    state = out[ACTION_SIZE : ACTION_SIZE + MODEL_STATE_SIZE]
    for quadrotor, pendulum in ((POSITION, PENDULUM), (VELOCITY, PENDULUM_RATE)):
        state[pendulum] += parameters.rod_length * gains[quadrotor][:2]
    return np.asarray(out * deviation_scales(parameters.hover_thrust)[:, np.newaxis])
