"""The files of an identification: the vehicle with the source and interval of each number, and scenarios for training.

The two scenarios have calm air and a fluctuating force, act at 25 Hz, and draw inertia, thrust and rotor lag for each
episode: from the intervals of what the logs show, within ± 30 % of what they do not show.
"""

from pathlib import Path
from typing import Any

import numpy as np

from quadpend_gym.vehicles import Vehicle, rotors_of
from quadpend_train.common.files import write_text
from quadpend_train.flight_logs.identify import COMMANDS, POLE, QUANTITIES, Estimate, Found
from quadpend_train.flight_logs.log import NOMINAL

_UNKNOWN = 0.3  # half width of the range of what the logs do not show, as a share
_LEAST = 0.02  # half width of every range: models are not exact
_WIND = 0.045  # fluctuating force on each axis as a share of the weight, as in `hummingbird_windy`
SETTINGS = "ppo-flight"  # preset for a first training in the scenarios


def write_vehicle(found: Found, start: Vehicle, path: Path) -> Path:
    """Write the vehicle file, and beside it the scenarios for training; return the path of the latter."""
    write_text(path, vehicle_text(found, start))
    training = path.with_name(f"{path.stem}-training.toml")
    write_text(training, training_text(found, path))
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


def training_text(found: Found, path: Path) -> str:
    """Return the scenarios for training with the vehicle file at `path`."""
    estimates, roll_pitch_yaw = found.estimates, np.diag(found.vehicle.inertia_matrix).tolist()
    shares = {name: _share(estimates[name]) for name in ("inertia_roll", "inertia_pitch", "thrust_coefficient", "lag")}
    shares["inertia_yaw"] = max(shares["inertia_roll"], shares["inertia_pitch"], _share(estimates["torque_per_thrust"]))
    names = ("inertia_roll", "inertia_pitch", "inertia_yaw")
    ranges = [f"{name} = {_around(value, shares[name])}" for name, value in zip(names, roll_pitch_yaw, strict=True)]
    if "pole_length" in estimates:
        ranges.append(f"rod_length = {_around(found.vehicle.pole.length, _share(estimates['pole_length']))}  # m")
    loop = found.vehicle.rate_loop.time_constant / max(rotors_of(found.vehicle).lag_up, 1e-9)
    lag = min(1.0 + shares["lag"], 2.0 * loop)  # the rate loop must not be faster than half the lag
    force = f'{{kind = "ornstein_uhlenbeck", force = {_WIND * found.vehicle.weight:.3g}}}  # N'
    winds = {"calm": '"calm"', "windy": force}
    scenarios = [f"[scenarios.{path.stem}_{name}]\nwind = {wind}\n" for name, wind in winds.items()]
    return "\n".join(
        [
            f"# Training on {path.name} and its uncertainty:",
            f"# quadpend train --settings {SETTINGS} --scenarios {path.stem}-training.toml --out runs/{path.stem}",
            "[defaults]",
            f'vehicle = "{path.as_posix()}"',
            'interface = "body_rates"',
            "period = 0.04  # s; learning needs fewer steps than at 100 Hz",
            "substeps = 8",
            "[defaults.parameters]  # kg·m²",
            *ranges,
            "[defaults.loop]  # factors",
            f"thrust = {_around(1.0, shares['thrust_coefficient'])}",
            f"rotor_lag = [{1.0 - shares['lag']:.4g}, {lag:.4g}]",
            "",
            *scenarios,
        ]
    )


def _share(estimate: Estimate) -> float:
    """Return half the width of a range as a share of the value."""
    low, high = estimate.interval
    return min(_UNKNOWN, max(_LEAST, 0.5 * (high - low) / estimate.value)) if estimate.identified else _UNKNOWN


def _around(value: float, share: float) -> str:
    return f"[{(1.0 - share) * value:.4g}, {(1.0 + share) * value:.4g}]"


def _interval(estimate: Estimate) -> str:
    if not estimate.identified:
        return f"{estimate.name} not identified"
    low, high = estimate.interval
    return f"{estimate.name} {low:.4g} to {high:.4g} {QUANTITIES[estimate.name].unit}"


def _plain(value: Any) -> str:
    if isinstance(value, str):
        return value
    return f"[{', '.join(map(_plain, value))}]" if isinstance(value, list | tuple) else f"{value:.5g}"
