"""The innovations of the observer, filtered: the memory of a network.

Every controller that stabilises a linear model is the feedback of an observer plus a stable filter of its innovations ν
(Youla's parametrisation). With three such filters a network comes close to other observers: one with more trust in the
sensors, or one that knows how a disturbance goes on. In control step k, with ν in the axes of the heading at that time,

    (1)  f_k = f_{k−1} + (1 − e^{−T/τ}) (ν_k − f_{k−1}),     τ = 0.02, 0.06 and 0.2 s;   f = 0 at the start

| part                                                                         | size | scale           |
|------------------------------------------------------------------------------|------|-----------------|
| ν of position (m), r_x r_y and φ θ ψ (rad), in the axes of the heading       | 8    | 1 mm, and 0.001 |
| f for each of the three τ                                                    | 24   | the same        |

Source: Zhou, Doyle and Glover, Robust and optimal control, 1996, section 12.3.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from quadpend_baselines.estimation.estimate import INNOVATION, STATE
from quadpend_baselines.hybrid.parts import InputPart, Seen
from quadpend_baselines.modelling.quantities import load_state, turn3
from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.elementary import sincos
from quadpend_gym.core.jit import compiled

_TIMES = 0.02, 0.06, 0.2  # τ, s
_SCALE = 1e-3
_SIZE = 8  # of ν
FILTERED_SIZE = _SIZE * len(_TIMES)
INNOVATIONS_SIZE = _SIZE + FILTERED_SIZE


@lru_cache(maxsize=32)
def filter_shares(period: float, times: tuple[float, ...]) -> Floats:
    """Return 1 − e^{−T/τ} for each τ."""
    return np.asarray(1.0 - np.exp(-period / np.array(times)))


@compiled
def _inputs(estimate: Floats, filtered: Floats, shares: Floats, out: Floats) -> None:
    for row in range(out.shape[0]):
        error = load_state(estimate.T, INNOVATION, row)
        sine, cosine = sincos(load_state(estimate.T, STATE, row).euler.z)
        position, direction = turn3(error.position, -sine, cosine), turn3(error.direction, -sine, cosine)
        for i in range(3):
            out[row, i], out[row, 5 + i] = position[i] / _SCALE, error.euler[i] / _SCALE
        for i in range(2):
            out[row, 3 + i] = direction[i] / _SCALE
        for j in range(shares.shape[0]):
            for i in range(_SIZE):
                last = filtered[row, j * _SIZE + i]
                out[row, (j + 1) * _SIZE + i] = last + shares[j] * (out[row, i] - last)


def _innovations(period: float, seen: Seen, memory: Any) -> tuple[Any, Any]:
    out = np.empty((len(memory), INNOVATIONS_SIZE))
    _inputs(seen.estimate, np.ascontiguousarray(memory), filter_shares(period, _TIMES), out)
    return out, out[:, _SIZE:]


def innovations_part(period: float) -> InputPart:
    """Return ν and f; f is the memory. The control period is in s."""
    return InputPart(INNOVATIONS_SIZE, FILTERED_SIZE, _innovations, period)
