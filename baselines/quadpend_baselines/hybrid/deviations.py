"""The deviation of an estimate from the trajectory that follows the reference, as inputs of a network.

A network that observes deviations acts alike at every place, for every heading and, near the reference, in any motion.
The trajectory and the linear state z are those of `controllers.lqg`; all vectors are in the axes of the heading.

| part                                                     | size | scale                        |
|----------------------------------------------------------|------|------------------------------|
| a_d, the action that follows the reference in still air  | 4    | 1                            |
| tracking error ζ + l r_xy, and its rate                  | 6    | 0.05 m, 0.2 m/s              |
| attitude, and its rate, less those of the trajectory     | 6    | 0.05 rad, 0.4 rad/s          |
| r_x r_y, and their rates, less those of the trajectory   | 4    | 0.05, 0.2 1/s                |
| thrusts of the rotors, less those of the trajectory      | 4    | 0.02 W                       |
| estimated force, force on the bob (x, y), torque         | 8    | 0.05 W, 0.01 W, 0.001 W · 1 m |
| acceleration of the reference, and the rate of its yaw   | 4    | 2 m/s², 1 rad/s              |

W is the weight at hover (N). Forces and thrusts are divided by μ, the estimated ratio of the mass to the nominal one,
and the thrust in a_d is μ (1 + a_d) − 1. A vehicle without rotors has zeros for their thrusts.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from quadpend_baselines.controllers.lqg import Lqg, evaluate
from quadpend_baselines.estimation.estimate import MASS_RATIO, Estimate, law_inputs, nominal
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_baselines.modelling.linear_model import (
    MODEL_BOB_FORCE,
    MODEL_DISTURBANCE_SIZE,
    MODEL_FORCE,
    MODEL_STATE_SIZE,
    MODEL_TORQUE,
    PENDULUM,
    PENDULUM_RATE,
    VELOCITY,
)
from quadpend_baselines.modelling.quantities import turn3
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled
from quadpend_gym.physics.state import ACTION_SIZE, THRUST

_FIRST_THRUST = ACTION_SIZE + MODEL_STATE_SIZE
_FIRST_DISTURBANCE = _FIRST_THRUST + ACTION_SIZE
_FIRST_REFERENCE = _FIRST_DISTURBANCE + MODEL_DISTURBANCE_SIZE
DEVIATION_SIZE = _FIRST_REFERENCE + 4
_STATE_SCALE = np.repeat([0.05, 0.2, 0.05, 0.4, 0.05, 0.2], [3, 3, 3, 3, 2, 2])


@compiled
def _inputs(estimate: Floats, action: Floats32, z: Floats, scales: Floats, length: float, out: Floats) -> None:
    thrusts = z.shape[1] - MODEL_STATE_SIZE - MODEL_DISTURBANCE_SIZE
    for row in range(out.shape[0]):
        state, _, reference = law_inputs(estimate, row)
        sine, cosine = sincos(state.euler.z)
        for i in range(ACTION_SIZE):
            out[row, i] = action[row, i]
            out[row, _FIRST_THRUST + i] = 0.0
        out[row, THRUST] = estimate[row, MASS_RATIO] * (1.0 + action[row, THRUST]) - 1.0
        for i in range(MODEL_STATE_SIZE):
            out[row, ACTION_SIZE + i] = z[row, i]
        for i in range(2):
            out[row, ACTION_SIZE + i] += length * z[row, PENDULUM.start + i]
            out[row, ACTION_SIZE + VELOCITY.start + i] += length * z[row, PENDULUM_RATE.start + i]
        for i in range(thrusts):
            out[row, _FIRST_THRUST + i] = z[row, MODEL_STATE_SIZE + i]
        for i in range(MODEL_DISTURBANCE_SIZE):
            out[row, _FIRST_DISTURBANCE + i] = z[row, MODEL_STATE_SIZE + thrusts + i]
        acceleration = turn3(reference.d2, -sine, cosine)
        for i in range(3):
            out[row, _FIRST_REFERENCE + i] = acceleration[i]
        out[row, _FIRST_REFERENCE + 3] = reference.yaw.y
        for i in range(DEVIATION_SIZE):
            out[row, i] /= scales[i]


@lru_cache(maxsize=32)
def deviation_scales(weight: float) -> Floats:
    """Return the scales of the inputs, shape (36,), for a vehicle of a weight (N)."""
    wind = np.empty(MODEL_DISTURBANCE_SIZE)
    wind[MODEL_FORCE], wind[MODEL_BOB_FORCE], wind[MODEL_TORQUE] = 0.05 * weight, 0.01 * weight, 0.001 * weight
    action, thrusts, reference = np.ones(ACTION_SIZE), np.full(ACTION_SIZE, 0.02 * weight), [2.0, 2.0, 2.0, 1.0]
    return np.concatenate([action, _STATE_SCALE, thrusts, wind, reference])


def _deviations(law: Lqg, seen: Seen, memory: Any) -> tuple[Floats, Any]:
    estimate = nominal(Estimate(seen.later))
    _, following, z, _ = evaluate(law, estimate)
    parameters, out = law.simulation.parameters, np.empty((len(z), DEVIATION_SIZE))
    _inputs(estimate.array, following, z, deviation_scales(parameters.hover_thrust), parameters.rod_length, out)
    return out, memory


def deviation_part(law: Lqg) -> InputPart:
    """Return the deviation of the estimate at the time when the next action acts."""
    return InputPart(DEVIATION_SIZE, 0, _deviations, law)
