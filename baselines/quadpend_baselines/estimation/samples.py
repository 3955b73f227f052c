"""Which samples correct an estimate: not old, repeated or impossible ones.

A sample is missing if it is old, which its age tells, or if all its numbers are those of the sample before, which a
frozen sensor repeats: at most `REPEATS` samples in a row, because a simulation without noise repeats samples at rest.
It is refused if its position or its direction is further from the prediction than

    (1)  g + g' t + ½ g'' t²         t: time since the latest correction

`MOST_REFUSED` in a row at most: then position, angles and direction of the estimate begin anew at the sample. What an
observation with errors alone tells is always used: it has no age, and a moving reference moves it.
"""

from typing import Any, NamedTuple

from quadpend_baselines.estimation.estimate import AGE, ANCHOR, HELD, REFUSED, REPEATED, SAMPLE, STATE
from quadpend_gym.core.elementary import select
from quadpend_gym.core.jit import inlined
from quadpend_gym.physics.state import DIRECTION, EULER, POSITION

REPEATS = 0.3  # s
MOST_REFUSED = 5
COASTS = 30  # control periods without a correction for which the Kalman filter has a gain of its own
# g, g' and g'' of position (m) and direction (1), in s: five times the largest seen in the scenarios of training, with
# coasts of up to 0.1 s, and three times it with coasts of 0.3 s
_LIMITS = (0.06, 0.06), (0.2, 0.15), (8.0, 6.0)
_USED = POSITION, EULER, DIRECTION


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
    change, off, turned = remember(memory, lane, seen), 0.0, 0.0
    for k in range(3):
        error = seen[POSITION + k, lane] - memory[ANCHOR + k, lane] - expected[STATE + POSITION + k, lane]
        off += error * error
        error = seen[DIRECTION + k, lane] - expected[STATE + DIRECTION + k, lane]
        turned += error * error
    held, t = memory[HELD, lane], period * (memory[HELD, lane] + 1.0)
    repeated = select(change > 0.0, 0.0, memory[REPEATED, lane] + 1.0)
    is_repeated = select(repeated > 0.5, select(repeated * period > REPEATS, 0.0, 1.0), 0.0)
    absent = doubts * select(seen[AGE, lane] > 0.0, 1.0, is_repeated)
    position = width * (_LIMITS[0][0] + t * (_LIMITS[1][0] + 0.5 * t * _LIMITS[2][0]))
    direction = width * (_LIMITS[0][1] + t * (_LIMITS[1][1] + 0.5 * t * _LIMITS[2][1]))
    far = select(off > position * position, 1.0, select(turned > direction * direction, 1.0, 0.0))
    far *= doubts * (1.0 - absent)
    refused = absent * memory[REFUSED, lane] + far * (memory[REFUSED, lane] + 1.0)
    begins = select(refused > MOST_REFUSED + 0.5, far, 0.0)
    missing = max(absent, far) * (1.0 - begins)
    memory[REPEATED, lane], memory[REFUSED, lane] = repeated, refused * (1.0 - begins)
    memory[HELD, lane] = missing * (held + 1.0)
    return Verdict(missing, begins)


@inlined
def gain_row(age: float, held: float, rows: int) -> int:
    """Return the row of a table of gains, which has those after coasts behind those of the first corrections.

    Args:
        age: Number of the correction.
        held: Periods without a correction before it.
        rows: Number of rows of the table.
    """
    first = rows - COASTS
    return int(first + min(held, COASTS) - 1.0 + 0.5) if held > 0.5 else int(min(age, first) - 1.0 + 0.5)
