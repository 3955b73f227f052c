"""The throttle for a thrust, from thrusts that were measured at several throttles and voltages of the battery."""

from typing import Annotated

import numpy as np

from quadpend_gym.core.settings import Range, settings


@settings
class ThrustTable:
    """Measured thrust of one rotor. Between the measurements it is linear in throttle and in voltage."""

    throttles: Annotated[tuple[float, ...], Range(0.0, 1.0)]  # share of the channel from its lowest to its highest
    voltages: Annotated[tuple[float, ...], Range(0.1, 100.0, "V")]  # of the battery under load
    thrusts: Annotated[tuple[tuple[float, ...], ...], Range(0.0, 1e4, "N")]  # a row for each voltage

    def __post_init__(self) -> None:
        for name, values in (("throttles", self.throttles), ("voltages", self.voltages)):
            if not values or (np.diff(values) <= 0.0).any():
                raise ValueError(f"{name} must increase, not {values}")
        if len(self.throttles) < 2 or np.shape(self.thrusts) != (len(self.voltages), len(self.throttles)):
            raise ValueError(
                f"thrusts must have a row of {len(self.throttles)} numbers, at least 2, for each of"
                f" {len(self.voltages)} voltages"
            )
        if (np.diff(self.thrusts, axis=1) <= 0.0).any():
            raise ValueError(f"thrusts must increase with the throttle, not {self.thrusts}")

    def throttle(self, thrust: float, voltage: float) -> float:
        """Return the throttle for a thrust of one rotor, N.

        Beyond the measured voltages the nearest one counts. A thrust that was not reached gets the nearest throttle.
        """
        row = [np.interp(voltage, self.voltages, column) for column in zip(*self.thrusts, strict=True)]
        return float(np.interp(thrust, row, self.throttles))
