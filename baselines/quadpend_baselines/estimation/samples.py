"""Which samples correct an estimate: not old, repeated or impossible ones.

A sample is missing if it is old, which its age tells, or if all its numbers are those of the sample before, which a
frozen sensor repeats: at most `REPEATS` samples in a row, because a simulation without noise repeats samples at rest.
It is refused if its position, its Euler angles or its direction are further from the prediction than

    (1)  g + g' t + ½ g'' t²         t: time since the latest correction

and errors of more than a fifth of that count as a fifth in the Kalman filter, as in Huber's M-estimator.
`MOST_REFUSED` in a row at most: then position, angles and direction of the estimate begin anew at the sample. What an
observation with errors alone tells is always used: it has no age, and a moving reference moves it.
"""

from typing import Any, NamedTuple

import numpy as np

from quadpend_baselines.estimation.estimate import AGE, ANCHOR, HELD, REFUSED, REPEATED, SAMPLE, STATE
from quadpend_gym.core.elementary import select
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.state import DIRECTION, EULER, POSITION
from quadpend_gym.physics.vectors import Vec3, dot

REPEATS = 0.3  # s
MOST_REFUSED = 5
EARLY = 30  # corrections after which the gain of the Kalman filter has settled within 1 %
COASTS = 30  # control periods without a correction for which the Kalman filter has a gain of its own
_USED = POSITION, EULER, DIRECTION
# g, g' and g'' of these (m, rad and 1), in s: of position and direction five times the largest seen in the scenarios of
# training, with coasts of up to 0.1 s, and three times it with coasts of 0.3 s; those of angles are set by hand
GATES = (0.06, 0.2, 8.0), (0.6, 3.0, 30.0), (0.06, 0.15, 6.0)
_FULL = 0.2  # share of equation (1) up to which an error counts in full


class Verdict(NamedTuple):
    """What becomes of a sample: 1 or 0, one of both at most."""

    missing: float  # it corrects nothing
    begins: float  # positions and angles begin anew at it


@inlined
def remember(memory: Any, lane: int, seen: Any) -> float:
    """Write a sample into an estimate, and return how much its numbers differ from those of the sample before."""
    change = 0.0
    for i in range(len(_USED)):
        for k in range(3):
            now = seen[_USED[i] + k, lane]
            change += abs(now - memory[SAMPLE + 3 * i + k, lane])
            memory[SAMPLE + 3 * i + k, lane] = now
    return change


@inlined
def _limit(i: int, t: float) -> float:
    """Return equation (1) for item i of `_USED`."""
    return GATES[i][0] + t * (GATES[i][1] + 0.5 * t * GATES[i][2])


@inlined
def full_share(i: int, error: Vec3, t: float, doubts: float) -> float:
    """Return the share of an error that counts; i is 0, 1 or 2 for position, angles or direction, see `judge`."""
    limit = _FULL * _limit(i, t)
    square = max(dot(error, error), limit * limit)  # no slope at 0 is infinite
    return float(1.0 - doubts * (1.0 - limit / np.sqrt(square)))


@inlined
def judge(memory: Any, expected: Any, lane: int, seen: Any, period: float, doubts: float, width: float) -> Verdict:
    """Return the verdict on a sample for an estimate that was advanced to its time, and count it in the estimate.

    Args:
        memory: The estimate.
        expected: Lanes with the state that is expected.
        lane: Their column.
        seen: The measurement.
        period: Control period, s.
        doubts: 1, or 0 for observations whose samples are always used.
        width: Factor on equation (1).
    """
    change, far = remember(memory, lane, seen), 0.0
    held, t = memory[HELD, lane], period * (memory[HELD, lane] + 1.0)
    repeated = select(change > 0.0, 0.0, memory[REPEATED, lane] + 1.0)
    is_repeated = select(repeated > 0.5, select(repeated * period > REPEATS, 0.0, 1.0), 0.0)
    absent = doubts * select(seen[AGE, lane] > 0.0, 1.0, is_repeated)
    for i in range(len(_USED)):
        off = 0.0
        for k in range(3):
            error = seen[_USED[i] + k, lane] - expected[STATE + _USED[i] + k, lane]
            error -= memory[ANCHOR + k, lane] if i == 0 else 0.0
            error -= 2.0 * np.pi * np.rint(error / (2.0 * np.pi)) if i == 1 else 0.0
            off += error * error
        limit = width * _limit(i, t)
        far = select(off > limit * limit, 1.0, far)
    far *= doubts * (1.0 - absent)
    refused = absent * memory[REFUSED, lane] + far * (memory[REFUSED, lane] + 1.0)
    begins = select(refused > MOST_REFUSED + 0.5, far, 0.0)
    missing = max(absent, far) * (1.0 - begins)
    memory[REPEATED, lane], memory[REFUSED, lane] = repeated, refused * (1.0 - begins)
    memory[HELD, lane] = (1.0 - begins) * (held + missing)  # a correction sets it to 0
    return Verdict(missing, begins)


@inlined
def gain_row(age: float, held: float, rows: int) -> int:
    """Return the row of a table of gains, which has those after coasts behind those of the first corrections.

    Args:
        age: Number of corrections before.
        held: Periods since the latest one without a correction; the first `EARLY` corrections do not count them.
        rows: Number of rows of the table.
    """
    first = rows - COASTS
    is_coast = held > 0.5 and age > EARLY - 0.5
    return int(first + min(held, COASTS) - 1.0 + 0.5) if is_coast else int(min(age, first - 1.0) + 0.5)
