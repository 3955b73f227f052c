"""Jumps of the reference: it moves at once to a random side and later back, in turn."""

from typing import Annotated

import numpy as np

from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.settings import Interval, Range, settings
from quadpend_gym.core.streams import Streams
from quadpend_gym.tasks.references import CHANNELS

_NUMBERS = 5  # random numbers of a jump


@settings
class Jumps:
    """Jumps of the reference's position and yaw; its derivatives do not change."""

    # horizontal distance of a jump, uniform in this interval, to a random side
    distance: Annotated[Interval, Range(0.0, 1000.0, "m")] = (0.0, 0.0)
    yaw: Annotated[Interval, Range(0.0, np.pi, "rad")] = (0.0, 0.0)  # angle of a jump, to the left or to the right
    pause: Annotated[Interval, Range(1e-3, 1e6, "s")] = (2.0, 3.0)  # time before each jump, out or back

    def __post_init__(self) -> None:
        if self.distance[1] == 0.0 and self.yaw[1] == 0.0:
            raise ValueError("jumps must have a distance or a yaw above zero")

    def draw(self, number: Integers, streams: Streams) -> tuple[Floats, Floats]:
        """Return offset and pause of the jumps with these numbers, shapes (n, 4) and (n,).

        The offset of the channels (F_x, F_y, z, ψ) from the reference without jumps is that until the next jump: 0
        after a jump with an odd number.
        """
        lowest, highest = zip(self.pause, self.distance, (-np.pi, np.pi), self.yaw, (-1.0, 1.0), strict=True)
        numbers = np.stack([streams.uniform(_NUMBERS * number + i, 1)[:, 0] for i in range(_NUMBERS)])
        low, high = np.array(lowest)[:, np.newaxis], np.array(highest)[:, np.newaxis]
        pause, distance, heading, yaw, side = low + (high - low) * numbers
        offset = np.zeros((number.size, CHANNELS))
        offset[:, 0], offset[:, 1] = distance * np.cos(heading), distance * np.sin(heading)
        offset[:, 3] = np.copysign(yaw, side)
        offset[number % 2 == 1] = 0.0
        return offset, pause


class JumpingRows:
    """The jumps of n sub-environments.

    Attributes:
        offset: Offset of each reference from the one without jumps, shape (n, 4).
    """

    def __init__(self, jumps: Jumps, rows: int, period: float) -> None:
        self._jumps, self._period = jumps, period
        self.offset = np.zeros((rows, CHANNELS))
        self._next, self._number = np.zeros(rows, np.int64), np.zeros(rows, np.int64)
        self._streams = Streams(np.zeros(rows, np.uint64))

    def start_episodes(self, rows: Integers, streams: Streams) -> None:
        """Start new episodes in the sub-environments `rows`, shape (m,), with their random streams."""
        self._streams.keys[rows] = streams.keys
        self.offset[rows], self._number[rows], self._next[rows] = 0.0, 0, 0
        self._set_next(rows)

    def _set_next(self, rows: Integers) -> None:
        _, pause = self._jumps.draw(self._number[rows], self._streams[rows])
        self._next[rows] += np.maximum(np.ceil(pause / self._period - 1e-9), 1.0).astype(np.int64)

    def jump(self, step: Integers) -> Integers:
        """Let the references jump whose time has come at the control step `step`, shape (n,); return their rows."""
        rows = np.flatnonzero(step >= self._next)
        if rows.size:
            self.offset[rows], _ = self._jumps.draw(self._number[rows], self._streams[rows])
            self._number[rows] += 1
            self._set_next(rows)
        return rows
