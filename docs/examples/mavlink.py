"""A link to PX4 by MAVLink, to copy: `quadpend fly lqg.c --to mavlink:link`.

Its bytes are tested against pymavlink's own parser. No autopilot was at hand: nothing here has moved a motor. Arming,
the offboard mode and the kill stay with the pilot; on lost set-points PX4 acts by COM_OF_LOSS_T and COM_OBL_RC_ACT. Not
for ArduPilot, which takes the thrust for a rate of climb.
"""

import time
from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.vehicles import Simulation, rotors_of

ADDRESS = "udpout:127.0.0.1:14540"
_ONLY_RATES = 128  # type_mask: ignore the attitude


class Mavlink:
    """Sends SET_ATTITUDE_TARGET; MAVLink has x forward, y right, z down, and thrust from 0 to 1."""

    def __init__(self, simulation: Simulation, connection: Any) -> None:
        (self._low, self._high), self._connection = rotors_of(simulation.vehicle).thrust, connection

    def send(self, command: Floats, is_armed: bool) -> None:
        """Send thrust and rates; disarmed, thrust is 0."""
        share = np.clip((0.25 * command[0] - self._low) / (self._high - self._low), 0.0, 1.0) if is_armed else 0.0
        p, q, r = command[1:].tolist()
        now = int(1e3 * time.monotonic()) % 2**32
        self._connection.mav.set_attitude_target_send(now, 1, 1, _ONLY_RATES, [1, 0, 0, 0], p, -q, -r, float(share))

    def silence(self) -> float:
        """Return 0: nothing answers each message."""
        return 0.0

    def motors(self) -> Floats:
        """Return that they are unknown."""
        return np.full(4, np.nan)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


def link(simulation: Simulation) -> Mavlink:
    """Return a link to `ADDRESS`."""
    from pymavlink import mavutil

    return Mavlink(simulation, mavutil.mavlink_connection(ADDRESS, dialect="common"))
