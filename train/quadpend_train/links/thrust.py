"""Throttle and thrust of a rotor: linear, or measured at several throttles and voltages of the battery."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from quadpend_gym.core.settings import Range, settings


@dataclass(frozen=True)
class ThrustCurve:
    """Thrusts (N) of one rotor at throttles, both increasing, linear in between; beyond them the nearest one counts."""

    throttles: Any
    thrusts: Any

    def throttle(self, thrust: Any) -> Any:
        """Return the throttle, 0 to 1, for a thrust of one rotor, N."""
        return np.interp(thrust, self.thrusts, self.throttles)

    def thrust(self, throttle: Any) -> Any:
        """Return the thrust of one rotor, N, at a throttle."""
        return np.interp(throttle, self.throttles, self.thrusts)


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

    def at(self, voltage: float) -> ThrustCurve:
        """Return the curve at a voltage; beyond the measured ones the nearest one counts."""
        row = [np.interp(voltage, self.voltages, column) for column in zip(*self.thrusts, strict=True)]
        return ThrustCurve(self.throttles, row)
