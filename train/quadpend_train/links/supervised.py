"""Exported C with its supervisor for one flight, called as firmware calls it; docs/deploy.md has its statuses."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.core.c_library import load_c
from quadpend_train.policies.compiled import SupervisedPolicy

OFF, HOLD, FLY, KILL = range(4)  # requests and stages
STAGES = "OFF", "HOLD", "FLY", "KILL"
_REAL = ctypes.c_double


class Fields(ctypes.Structure):
    """The public fields of the supervisor in policy.h, in double precision; the limits stand from `pole_tilt` on."""

    _fields_ = (
        ("request", ctypes.c_int),
        *((name, _REAL) for name in ("pole_tilt", "body_tilt", "distance", "lowest", "highest", "speed", "age")),
        ("caution", _REAL),
        ("innovations", _REAL * 3),
        ("set_point", _REAL * 2),
        ("yaw", _REAL * 2),
        ("stage", ctypes.c_int),
        ("status", ctypes.c_uint32),
        ("cause", ctypes.c_uint32),
        *((name, _REAL) for name in ("blind", "innovation", "saturated")),
        ("reference", _REAL * 26),
    )


class Supervised:
    """A C file that `quadpend export` has written, compiled in double precision.

    Args:
        path: The source, beside its header.

    Attributes:
        name: The name of the policy in the source.
        designed: PERIOD, LATENCY, INTERFACE and VEHICLE of the header, as text.
        bits: The bits of a status by name.
        fields: What the C library reads and writes.
        command: Thrust (N) and body rates (rad/s) of the latest step, shape (4,).
    """

    def __init__(self, path: str | Path) -> None:
        policy = SupervisedPolicy(path, ("QUADPEND_DOUBLE",))
        self.name, self.designed, self.bits = policy.name, policy.designed, policy.statuses
        self._library: Any = load_c(policy.source)
        self._step = self._function("supervise")
        self._memory = ctypes.create_string_buffer(self._library.memory_size())
        self._function("supervisor_reset")(self._memory)
        self.fields, self.command = Fields.from_buffer(self._memory), np.zeros(4)

    def _function(self, name: str) -> Any:
        return getattr(self._library, f"{self.name}_{name}")

    def step(self, sample: Floats | None, request: int, reference: Floats | None = None) -> int:
        """Step with a sample, shape (11,), or None; return the status. None as a reference is the set point."""
        self.fields.request = request
        given = [None if x is None else np.ascontiguousarray(x, float) for x in (sample, reference)]
        pointers = [x if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in (*given, self.command)]
        return int(self._step(self._memory, *pointers))

    def names(self, status: int) -> list[str]:
        """Return the names of the bits of a status."""
        return [name for name, bit in self.bits.items() if status & bit]

    def go_to(self, position: Floats, yaw: float) -> None:
        """Move the set point to a position of the tracked point, m, and a yaw, rad."""
        self._function("go_to")(self._memory, (_REAL * 3)(*position), _REAL(yaw))
