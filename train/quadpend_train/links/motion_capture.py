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
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from quadpend_gym.core.arrays import Floats

_LAYOUT = struct.Struct("<4sI11d")
_MAGIC = b"QPM1"
SIZE = _LAYOUT.size


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
    """Finds the newest sample among datagrams, which may be lost, doubled, late or foreign; counts them."""

    def __init__(self) -> None:
        self.latest: Sample | None = None
        self.lost = self.late = self.foreign = 0

    def is_newer(self, counter: int) -> bool:
        """Whether a counter is that of a sample after the latest."""
        return self.latest is None or 0 < (counter - self.latest.counter) % 2**32 < 2**31

    def newest(self, datagrams: Iterable[bytes]) -> Sample | None:
        """Return the newest of the samples that arrived since the last call; None if none is newer than the latest."""
        found = None
        for datagram in datagrams:
            try:
                sample = unpack(datagram)
            except ValueError:
                self.foreign += 1
                continue
            if not self.is_newer(sample.counter):
                self.late += 1
                continue
            self.lost += 0 if self.latest is None else (sample.counter - self.latest.counter - 1) % 2**32
            self.latest = found = sample
        return found
