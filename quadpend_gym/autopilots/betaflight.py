"""Betaflight in place of the rate loop: its declaration, and the lines of its command line (CLI) for a vehicle.

Both tunes share what connects firmware and simulation: a mixer with the signs of the vehicle's rotors, radio channels
that are linear in thrust and body rates, arming by the channel AUX1, and no idle thrust (the simulated rotors have a
lowest thrust of their own).
"""

import os
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from quadpend_gym.autopilots.firmware import prepare
from quadpend_gym.core.arrays import Floats, Integers
from quadpend_gym.core.settings import Parsed, parse, settings
from quadpend_gym.physics.rotors import rate_loop_gains
from quadpend_gym.vehicles import Simulation, Vehicle, mixing, rotors_of

__all__ = ["AutopilotField", "Betaflight", "as_autopilot", "cli_lines", "full_rates", "radio"]

_AXES = "roll", "pitch", "yaw"
_MIN_CHECK, _MAX = 1005, 2000  # µs, the channels of the lowest and of the highest throttle
# Share of the motors' range per P · deg/s of the error and per D · deg/s² of the gyro: the firmware's PTERM_SCALE and
# DTERM_SCALE divided by its 1000 for the full range
_P_SCALE, _D_SCALE = 0.032029e-3, 0.000529e-3
_LARGEST_GAIN = 250
PID_PERIOD = 1e-3  # s: gyro and motors are exchanged at most that often

_LINK = f"""
feature -GPS
feature -TELEMETRY
aux 0 0 0 1700 2100 0 0
set small_angle = 180
set gyro_calib_duration = 50
set pwr_on_arm_grace = 0
set runaway_takeoff_prevention = OFF
set motor_pwm_protocol = PWM
set motor_idle = 0
set min_check = {_MIN_CHECK}
set pid_process_denom = 8
rateprofile 0
set rates_type = ACTUAL
set roll_expo = 0
set pitch_expo = 0
set yaw_expo = 0
"""

# No filters, and nothing but the proportional and the differential gains of `matched_gains`
_MATCHED = """
feature AIRMODE
set rc_smoothing = OFF
set gyro_lpf1_static_hz = 0
set gyro_lpf1_dyn_min_hz = 0
set gyro_lpf2_static_hz = 0
set gyro_notch1_hz = 0
set gyro_notch2_hz = 0
set yaw_spin_recovery = OFF
set simplified_gyro_filter = OFF
set simplified_pids_mode = OFF
set simplified_dterm_filter = OFF
set dterm_lpf1_static_hz = 0
set dterm_lpf1_dyn_min_hz = 0
set dterm_lpf2_static_hz = 0
set dterm_notch_hz = 0
set yaw_lowpass_hz = 0
set pidsum_limit = 1000
set pidsum_limit_yaw = 1000
set tpa_rate = 0
set anti_gravity_gain = 0
set iterm_relax = OFF
set feedforward_transition = 0
set throttle_boost = 0
set ez_landing_threshold = 25
set ez_landing_limit = 75
"""


def _read_tune(value: Any) -> Any:
    """Return the lines of the CLI in a file, without comments and empty lines; other values as they are."""
    if not isinstance(value, str | Path) or value in ("matched", "default"):
        return value
    if Path(value).suffix != ".txt":
        raise ValueError(f"the tune must be matched, default, or a file .txt with lines of the CLI, not {str(value)!r}")
    try:
        lines = Path(value).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"the tune {str(value)!r} cannot be read: {error}") from error
    stripped = [line.strip() for line in lines]
    return tuple(line for line in stripped if line and not line.startswith("#"))


_Tune = Literal["matched", "default"] | tuple[str, ...]


@settings
class Betaflight:
    """The Betaflight firmware in place of the rate loop, in the interface "body_rates".

    Tunes: ``matched``, whose gains are computed from the vehicle such that the loop has the time constant of the
    vehicle's rate loop; ``default``, the firmware's own gains and filters; or a file of lines of its CLI that change
    them (the field then holds the lines).
    """

    tune: Annotated[_Tune, BeforeValidator(_read_tune)] = "matched"
    # path of a SITL binary; None: that of the package ``betaflight``
    binary: str | None = field(default_factory=lambda: os.environ.get("BETAFLIGHT_SITL"))

    def prepare(self, simulation: Simulation) -> tuple[Path, Path]:
        """Build and configure what flies a simulation, see `firmware.prepare`."""
        return prepare(self.binary, cli_lines(self, simulation))

    def check(self, simulation: Simulation, rate_loop: Any) -> None:
        """Refuse a simulation that has no body rates or no rotors, and a `rate_loop` that is drawn."""
        vehicle = simulation.vehicle
        if simulation.interface != "body_rates" or vehicle.rotors is None:
            raise ValueError(
                "autopilot needs the interface 'body_rates' and a vehicle with rotors, not"
                f" {simulation.interface!r} and the vehicle {vehicle.name!r}"
            )
        if rate_loop is not None:
            raise ValueError("loop.rate_loop must be None with an autopilot, whose rate loop is its own")


def as_autopilot(value: Any) -> Betaflight | None:
    """Return an autopilot from itself, a text ``"betaflight[:TUNE]"``, a mapping of its fields, or None."""
    if isinstance(value, str):
        name, _, tune = value.partition(":")
        if name != "betaflight":
            raise ValueError(f"there is no autopilot {value!r}; there is 'betaflight', or 'betaflight:TUNE'")
        value = {"tune": tune} if tune else {}
    return None if value is None else parse(Betaflight, value, "autopilot")


# annotation of a field that holds an autopilot
AutopilotField = Parsed(as_autopilot, lambda: Annotated[str, Field(pattern="^betaflight(:.+)?$")] | Betaflight | None)


def full_rates(simulation: Simulation) -> Integers:
    """Return the body rates at full deflection of roll, pitch and yaw in 10 deg/s, the unit of the rate profile."""
    return np.ceil(np.degrees(simulation.command_scale[1:]) / 10.0).astype(np.int64)


def radio(thrust: Floats, rates: Floats, simulation: Simulation) -> Integers:
    """Return the channels roll, pitch, throttle and yaw in µs, shape (n, 4), rounded as a radio link rounds them.

    `thrust`, N, has the shape (n,); `rates`, rad/s, body frame (x forward, y left, z up), the shape (n, 3). The yaw
    channel of a radio is positive to the right.
    """
    low, high = rotors_of(simulation.vehicle).thrust
    throttle = np.clip((0.25 * thrust - low) / (high - low), 0.0, 1.0)
    sticks = 500.0 * rates / np.radians(10.0 * full_rates(simulation)) * (1.0, 1.0, -1.0)
    roll, pitch, yaw = 1500.0 + np.clip(sticks, -500.0, 500.0).T
    return np.rint([roll, pitch, _MIN_CHECK + (_MAX - _MIN_CHECK) * throttle, yaw]).astype(np.int64).T


def motor_mix(vehicle: Vehicle) -> Floats:
    """Return the mix of throttle, roll, pitch and yaw of each rotor in the signs of the firmware, shape (4, 4)."""
    rotors = rotors_of(vehicle)
    x, y, _ = np.array(rotors.positions).T
    return np.column_stack([np.ones(4), y / np.abs(y).max(), -x / np.abs(x).max(), -np.array(rotors.spins)])


def matched_gains(vehicle: Vehicle) -> tuple[Integers, Integers]:
    """Return the gains P and D of roll, pitch and yaw that make the loop as fast as the vehicle's rate loop.

    P and D act as k_ω and k_τ of `quadpend_gym.physics.rotors`, which multiply the same quantities, since a torque is
    the inertia times the angular acceleration. An axis that needs larger gains than the firmware permits is slower.
    """
    rotors, mix = rotors_of(vehicle), motor_mix(vehicle)[:, 1:] * (1.0, 1.0, -1.0)
    (low, high), lag = rotors.thrust, 0.5 * sum(rotors.lags)
    # angular accelerations, deg/s², for the full range of the motors
    reach = np.degrees((mixing(vehicle)[1:] * mix.T).sum(axis=1) * (high - low) / np.diag(vehicle.inertia_matrix))
    gains = []
    for per_output in reach.tolist():
        time_constant, p, d = vehicle.rate_loop.time_constant, np.inf, np.inf
        while max(p, d) > _LARGEST_GAIN:
            rate_gain, torque_gain = rate_loop_gains(time_constant, lag, PID_PERIOD)
            p, d = rate_gain / (per_output * _P_SCALE), torque_gain / (per_output * _D_SCALE)
            time_constant *= 1.02
        gains.append((p, d))
    p, d = np.rint(gains).astype(int).T
    return p, d


def cli_lines(autopilot: Betaflight, simulation: Simulation) -> tuple[str, ...]:
    """Return the lines of the firmware's CLI for a simulation: the tune, and what connects firmware and simulation."""
    vehicle, lines = simulation.vehicle, [] if isinstance(autopilot.tune, str) else [*autopilot.tune]
    if autopilot.tune == "matched":
        lines += _MATCHED.split("\n")
        for axis, p, d in zip(_AXES, *matched_gains(vehicle), strict=True):
            lines += [f"set p_{axis} = {p}", f"set i_{axis} = 0", f"set d_{axis} = {d}"]
            lines += [f"set d_max_{axis} = 0", f"set f_{axis} = 0"]
    lines += [*_LINK.split("\n"), "mixer CUSTOM", "mmix reset"]
    lines += [f"mmix {i} " + " ".join(f"{x:.3f}" for x in row) for i, row in enumerate(motor_mix(vehicle))]
    for axis, rate in zip(_AXES, full_rates(simulation), strict=True):
        lines += [f"set {axis}_rc_rate = {rate}", f"set {axis}_srate = {rate}"]
    return tuple(filter(None, lines))
