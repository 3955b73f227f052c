"""Samples of motion capture in UDP datagrams of 96 bytes, little-endian.

| bytes | type | content                                                                              |
|-------|------|--------------------------------------------------------------------------------------|
| 0–3   | text | ``QPM1``                                                                             |
| 4–7   | u32  | counter of the samples of the sender; it goes on with 0 after 2³² − 1                |
| 8–15  | f64  | time of the exposure by the sender's clock, s                                        |
| 16–39 | f64  | position of the vehicle's centre, m, world frame (z up)                              |
| 40–71 | f64  | quaternion of the body (x forward, y left, z up) to the world, in the order w, x, y, z |
| 72–95 | f64  | unit vector along the pole from its foot to its top, world frame                     |

A sender in Python is one line for each sample:

    socket.sendto(struct.pack("<4sI11d", b"QPM1", counter, time, *position, *quaternion, *direction), address)

What motion capture did not see is not a number (NaN): the supervisor of exported C takes the sample for missing.
"""

import struct
from typing import Any, NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats

_LAYOUT = struct.Struct("<4sI11d")
_MAGIC = b"QPM1"
SIZE = _LAYOUT.size
_RESTART = 0.5  # s without newer samples, after which another sender is accepted where nothing flies


class Sample(NamedTuple):
    """A sample, see the table above."""

    counter: int
    time: float
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    direction: tuple[float, float, float]

    def measurement(self, age: float) -> Floats:
        """Return the measurement of exported C, shape (11,), with its age in s."""
        return np.array([*self.position, *self.quaternion, *self.direction, age])

    def shown(self) -> str:
        """Return position (m), roll, pitch and yaw of the body and the tilt of the pole (degrees) for a terminal."""
        w, x, y, z = self.quaternion
        roll, pitch, yaw = np.degrees(
            [
                np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0)),
                np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            ]
        )
        tilt = np.degrees(np.arctan2(np.hypot(*self.direction[:2]), self.direction[2]))
        at = " ".join(f"{place:6.2f}" for place in self.position)
        return f"  at {at} m  roll {roll:4.0f} pitch {pitch:4.0f} yaw {yaw:4.0f}  pole {tilt:3.0f}°"


def pack(sample: Sample) -> bytes:
    """Return the datagram of a sample."""
    numbers = *sample.position, *sample.quaternion, *sample.direction
    return _LAYOUT.pack(_MAGIC, sample.counter, sample.time, *numbers)


def unpack(datagram: bytes) -> Sample:
    """Return the sample of a datagram.

    Raises:
        ValueError: It is none.
    """
    if len(datagram) != SIZE or not datagram.startswith(_MAGIC):
        raise ValueError(
            f"a sample has {SIZE} bytes and begins with {_MAGIC!r}, not {len(datagram)} with {datagram[:4]!r}"
        )
    _, counter, time, *x = _LAYOUT.unpack(datagram)
    return Sample(counter, time, (x[0], x[1], x[2]), (x[3], x[4], x[5], x[6]), (x[7], x[8], x[9]))


class Receiver:
    """Finds newer samples of one sender, the first, among datagrams that may be lost, doubled, late or foreign.

    Attributes:
        latest: The newest sample.
        lost, late, foreign: Numbers of samples and datagrams.
        restarts: How often another or a restarted sender was accepted.
    """

    def __init__(self) -> None:
        self.latest: Sample | None = None
        self.lost = self.late = self.foreign = self.restarts = 0
        self._sender: Any = None
        self._heard = 0.0

    def take(self, datagram: bytes, sender: Any, now: float, may_restart: bool) -> Sample | None:
        """Return the sample of a datagram; None if it is none, of another sender, or not newer than the latest.

        Args:
            datagram: What arrived.
            sender: Who sent it.
            now: When it arrived, s.
            may_restart: Whether another or a restarted sender is accepted after a silence.
        """
        try:
            sample = unpack(datagram)
        except ValueError:
            self.foreign += 1
            return None
        missed = -1 if self.latest is None else (sample.counter - self.latest.counter - 1) % 2**32
        if self._sender is None:
            self._sender = sender
        elif (sender != self._sender or missed >= 2**31 - 1) and may_restart and now - self._heard > _RESTART:
            self._sender, missed, self.restarts = sender, -1, self.restarts + 1
        elif sender != self._sender:
            self.foreign += 1
            return None
        elif missed >= 2**31 - 1:
            self.late += 1
            return None
        self.lost += max(missed, 0)
        self._heard, self.latest = now, sample
        return sample
