"""A link to a Crazyflie by cflib, to copy: `quadpend fly lqg.c --to crazyflie:link`.

Its bytes are tested against cflib's own packets. No Crazyflie was at hand: nothing here has moved a motor. The firmware
negates the yaw rate: check all signs with the propellers off.
"""

from typing import Any

import numpy as np

from quadpend_gym.core.arrays import Floats
from quadpend_gym.vehicles import Simulation, rotors_of

URI = "radio://0/80/2M/E7E7E7E7E7"


class Crazyflie:
    """Sends set-points of rates in deg/s, and thrust from 0 to 65535."""

    def __init__(self, simulation: Simulation, flown: Any) -> None:
        (self._low, self._high), self._flown = rotors_of(simulation.vehicle).thrust, flown
        for axis in ("Roll", "Pitch", "Yaw"):
            flown.param.set_value(f"flightmode.stabMode{axis}", "0")  # rates, not angles

    def send(self, command: Floats, is_armed: bool) -> None:
        """Send thrust and rates. A thrust of 0, as before arming, unlocks the firmware; disarmed, it is 0."""
        share = np.clip((0.25 * command[0] - self._low) / (self._high - self._low), 0.0, 1.0) if is_armed else 0.0
        p, q, r = np.degrees(command[1:]).tolist()
        self._flown.commander.send_setpoint(p, q, -r, int(65535 * share))

    def silence(self) -> float:
        """Return 0: nothing answers each message."""
        return 0.0

    def motors(self) -> Floats:
        """Return that they are unknown."""
        return np.full(4, np.nan)

    def close(self) -> None:
        """Close the radio."""
        self._flown.close_link()


def link(simulation: Simulation) -> Crazyflie:
    """Return a link to `URI`."""
    import cflib.crtp
    from cflib.crazyflie import Crazyflie as Flown
    from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

    cflib.crtp.init_drivers()
    connected = SyncCrazyflie(URI, cf=Flown())
    connected.open_link()
    return Crazyflie(simulation, connected.cf)
