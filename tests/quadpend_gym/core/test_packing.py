"""Tests of nested named tuples as flat arrays."""

from typing import NamedTuple

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.jit import compiled
from quadpend_gym.core.packing import pack, unpacker


class Inner(NamedTuple):
    """Two numbers."""

    first: float
    second: float


class Outer(NamedTuple):
    """Numbers of every type around a named tuple."""

    number: float
    inner: Inner
    flag: bool
    count: int


_unpack = unpacker(Outer)


@compiled
def _unpacked(packed: Floats) -> Outer:
    return _unpack(packed)


def test_unpacking_inverts_packing() -> None:
    for value in (Outer(0.5, Inner(1.5, -2.5), True, 3), Outer(-1.0, Inner(0.0, 1e9), False, 0)):
        assert _unpacked(pack(value)) == value
