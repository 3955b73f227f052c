"""The files of an identification: the vehicle with the source and interval of each number, and scenarios for training.

The two scenarios have calm air and a fluctuating force, and the loop of the flight benchmark: its latency, noise and
observation. They draw inertia, thrust and rotor lag for each episode: from the intervals of what the logs show; of what
they do not show, from 30 % below to 30 % above the values of the fit and of the start.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym import scenarios
from quadpend_gym.core.files import read_toml
from quadpend_gym.vehicles import Vehicle, rotors_of
from quadpend_train.common.files import write_text
from quadpend_train.common.vehicle_toml import vehicle_toml
from quadpend_train.flight_logs.identify import COMMANDS, QUANTITIES, Estimate, Found
from quadpend_train.flight_logs.log import NOMINAL

_UNKNOWN = 0.3  # half width of the range of what the logs do not show, as a share
_LEAST = 0.02  # half width of every range: models are not exact
_WIND = 0.045  # fluctuating force on each axis as a share of the weight, as in `hummingbird_windy`
_FLIGHT = read_toml(Path(scenarios.__file__).with_name("flight.toml"))["defaults"]
_LOOP = ("interface", "substeps", "latency", "observation", "actuators", "sensors")  # of the flight benchmark
SETTINGS = "ppo-flight"  # preset for a first training in the scenarios


def write_vehicle(found: Found, start: Vehicle, path: Path) -> Path:
    """Write the vehicle file, and beside it the scenarios for training; return the path of the latter."""
    write_text(path, vehicle_text(found, start))
    training = path.with_name(f"{path.stem}-training.toml")
    write_text(training, training_text(found, start, path))
    return training


def vehicle_text(found: Found, start: Vehicle) -> str:
    """Return the vehicle as TOML, with the source of each number on its line."""
    estimates, thrust = found.estimates, found.thrust
    logs, given = ", ".join(log.name for log in found.fitted), f"as {start.name}"

    def source(*names: str) -> str:
        return "; ".join(_interval(estimates[name]) for name in names)

    unchanged = ("mass", "gravity", "pivot", "pole.mass", "rotors.spins", "rate_loop.roll_pitch", "rate_loop.yaw")
    comments = dict.fromkeys(unchanged, given) | {
        "inertia": f"{source('inertia_roll', 'inertia_pitch')}; yaw: its ratio to the sum of both {given}",
        "pole.length": source("pole_length") if "pole_length" in estimates else given,
        "pole.drag_area": source("pole_drag_area") if "pole_drag_area" in estimates else given,
        "pole.inertia": f"J/(m l²) {given}",
        "rotors.positions": f"{given}; centre of mass: {source('centre_x', 'centre_y')}",
        "rotors.thrust": f"{given}, unless the logs have lower or higher ones",
        "rotors.torque_per_thrust": f"{source('torque_per_thrust')}; with the yaw inertia above",
        "rotors.lag_up": source("lag"),
        "rotors.inertia": f"{source('rotor_inertia')}; with the yaw inertia above",
        "rotors.thrust_coefficient": source("thrust_coefficient"),
        "drag.rotor": source("drag_x", "drag_y", "drag_z"),
        "drag.height": source("drag_height"),
        "drag.angular": source("angular_drag", "angular_drag_yaw"),
        "rate_loop.time_constant": f"{given}, but at least half the rotors' lag",
    }
    lines = [f"# Identified from {logs} with the mass and geometry of {start.name}. Intervals: 95 %."]
    lines += [f"# {sentence}." for sentence in found.sentences()]
    if found.fitted[0].is_command:
        k, share, exponent = (f"{each:.5g}" for each in (thrust.coefficient, thrust.linear, thrust.exponent))
        lines.append(
            f"# Thrust, N, by command u and voltage V: {k} ((1 − {share}) u² + {share} u) (V/{NOMINAL:g})^{exponent}"
        )
        lines.append(f"# {source('thrust_coefficient', *COMMANDS)}")
    return "\n".join([*lines, vehicle_toml(found.vehicle, comments, _inline)])


def training_text(found: Found, start: Vehicle, path: Path) -> str:
    """Return the scenarios for training with the vehicle file at `path`."""
    estimates, flown, guess = found.estimates, rotors_of(found.vehicle), rotors_of(start)
    moments = [np.diag(each.inertia_matrix).tolist() for each in (found.vehicle, start)]
    names = ("inertia_roll", "inertia_pitch", "inertia_yaw")
    shown = estimates | {"inertia_yaw": min((estimates[name] for name in names[:2]), key=lambda each: each.identified)}
    ranges = [f"{name} = {_range(shown[name], *values)}" for name, *values in zip(names, *moments, strict=True)]
    if "pole_length" in estimates:
        length = _range(estimates["pole_length"], found.vehicle.pole.length, start.pole.length)
        ranges.append(f"rod_length = {length}  # m")
    thrust = _range(estimates["thrust_coefficient"], 1.0, 1.0)
    shortest, longest = _range(estimates["lag"], 1.0, max(0.5 * sum(guess.lags) / max(flown.lag_up, 1e-9), 1e-9))
    loop = found.vehicle.rate_loop.time_constant / max(flown.lag_up, 1e-9)
    lag = [shortest, min(longest, 2.0 * loop)]  # the rate loop must not be faster than half the lag
    force = f'{{kind = "ornstein_uhlenbeck", force = {_WIND * found.vehicle.weight:.3g}}}  # N'
    winds = {"calm": '"calm"', "windy": force}
    tables = [f"[scenarios.{path.stem}_{name}]\nwind = {wind}\n" for name, wind in winds.items()]
    return "\n".join(
        [
            f"# Training on {path.name} and its uncertainty:",
            f"# quadpend train --settings {SETTINGS} --scenarios {path.stem}-training.toml --out runs/{path.stem}",
            "[defaults]",
            f'vehicle = "{path.as_posix()}"',
            *(f"{name} = {_inline(_FLIGHT[name])}" for name in _LOOP),
            "[defaults.parameters]  # kg·m²",
            *ranges,
            "[defaults.loop]  # factors",
            f"thrust = {thrust}",
            f"rotor_lag = {_inline(lag)}",
            "",
            *tables,
        ]
    )


def _range(estimate: Estimate, value: float, start: float) -> list[float]:
    """Return the range of a value of the fit: around it if it is identified, else around it and that of the start."""
    low, high = estimate.interval
    if estimate.identified:
        share = min(_UNKNOWN, max(_LEAST, 0.5 * (high - low) / estimate.value))
        return [_rounded((1.0 - share) * value), _rounded((1.0 + share) * value)]
    return [_rounded((1.0 - _UNKNOWN) * min(value, start)), _rounded((1.0 + _UNKNOWN) * max(value, start))]


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _interval(estimate: Estimate) -> str:
    if not estimate.identified:
        return f"{estimate.name} not identified"
    low, high = estimate.interval
    return f"{estimate.name} {low:.4g} to {high:.4g} {QUANTITIES[estimate.name].unit}"


def _inline(value: Any) -> str:
    """Return data of a TOML file in one line, numbers with six digits."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name} = {_inline(each)}' for name, each in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_inline, value))}]"
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)
