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
from quadpend_train.flight_logs.identify import COMMANDS, POLE, QUANTITIES, Estimate, Found
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
    vehicle, estimates, thrust = found.vehicle, found.estimates, found.thrust
    rotors, pole, loop, drag = rotors_of(vehicle), vehicle.pole, vehicle.rate_loop, vehicle.drag
    logs, given = ", ".join(log.name for log in found.fitted), f"as {start.name}"

    def source(*names: str) -> str:
        return "; ".join(_interval(estimates[name]) for name in names)

    inertia = np.diag(vehicle.inertia_matrix).tolist()
    extent = f", extent = {pole.extent:g}" if pole.extent else ""
    rows: list[tuple[str, Any, str]] = [
        ("mass", vehicle.mass, given),
        ("inertia", inertia, f"{source('inertia_roll', 'inertia_pitch')}; yaw: its ratio to the sum of both {given}"),
        ("gravity", vehicle.gravity, given),
        ("pivot", vehicle.pivot, given),
        (
            "pole",
            f"{{mass = {pole.mass:g}, length = {pole.length:g}, inertia = {pole.inertia:g},"
            f" drag_area = {pole.drag_area:g}{extent}}}",
            f"{source(*POLE)}; mass and J/(m l²) {given}" if POLE[0] in estimates else given,
        ),
        ("[rotors]", None, ""),
        ("positions", rotors.positions, f"{given}; centre of mass: {source('centre_x', 'centre_y')}"),
        ("spins", rotors.spins, given),
        ("thrust", rotors.thrust, f"{given}, unless the logs have lower or higher ones"),
        ("torque_per_thrust", rotors.torque_per_thrust, f"{source('torque_per_thrust')}; with the yaw inertia above"),
        ("lag_up", rotors.lag_up, source("lag")),
        ("inertia", rotors.inertia, f"{source('rotor_inertia')}; with the yaw inertia above"),
        ("thrust_coefficient", rotors.thrust_coefficient, source("thrust_coefficient")),
        ("[drag]", None, ""),
        ("rotor", drag.rotor, source("drag_x", "drag_y", "drag_z")),
        ("height", drag.height, source("drag_height")),
        ("angular", drag.angular, source("angular_drag", "angular_drag_yaw")),
        ("[rate_loop]", None, ""),
        ("time_constant", loop.time_constant, f"{given}, but at least half the rotors' lag"),
        ("roll_pitch", loop.roll_pitch, given),
        ("yaw", loop.yaw, given),
    ]
    lines = [f"# Identified from {logs} with the mass and geometry of {start.name}. Intervals: 95 %."]
    lines += [f"# {sentence}." for sentence in found.sentences()]
    if found.fitted[0].is_command:
        k, share, exponent = (f"{each:.5g}" for each in (thrust.coefficient, thrust.linear, thrust.exponent))
        lines.append(
            f"# Thrust, N, by command u and voltage V: {k} ((1 − {share}) u² + {share} u) (V/{NOMINAL:g})^{exponent}"
        )
        lines.append(f"# {source('thrust_coefficient', *COMMANDS)}")
    for name, value, text in rows:
        if value is None:
            lines += [name] if name.startswith("[") else []
        else:
            lines.append(f"{name} = {_plain(value)}  # {text}")
    return "\n".join(lines) + "\n"


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
            f"rotor_lag = {_plain(lag)}",
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


def _plain(value: Any) -> str:
    if isinstance(value, str):
        return value
    return f"[{', '.join(map(_plain, value))}]" if isinstance(value, list | tuple) else f"{value:.5g}"


def _inline(value: Any) -> str:
    """Return data of a TOML file in one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name} = {_inline(each)}' for name, each in value.items())}}}"
    return json.dumps(value)
