"""The flying page: vehicles that fly in the browser, from the C of `quadpend_gym.engines` and `quadpend export`.

    python -m docs.tools.flying_page  # compile the C to docs/tools/flying/*.wasm; needs clang and wasm-ld

`make docs` makes the page of the compiled files. Each of them ends with a hash of its C without tables and
functions of the equations, whose form and last digits depend on the computer. Tests compare it, and flights with
those of Python.
"""

import base64
import gzip
import hashlib
import json
import re
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from quadpend_gym import Scenario
from quadpend_gym.engines import columns, initial_memory, lift, observation_function, scalar_c, step_function, vector
from quadpend_gym.physics.attitude import quaternion_from_euler
from quadpend_gym.physics.state import DIRECTION, EULER, POSITION, STATE_SIZE
from quadpend_gym.physics.vectors import load
from quadpend_gym.scenarios import find_scenarios
from quadpend_gym.scenarios.scenario import wind_models
from quadpend_gym.tasks.observation import LAB
from quadpend_gym.vehicles.parameters import BOB_MASS, ROD_LENGTH
from quadpend_gym.viewer.snapshot import PAPER_SHAPE, shape_of
from quadpend_train.export import to_c
from quadpend_train.policies.loading import load_policy
from quadpend_train.reports import html_page

FOLDER = Path(__file__).with_name("flying")
# Each vehicle's scenario, for which its policies are designed, and the policies; the last one is the best network. The
# page begins with the first vehicle, its first policy and its last one.
VEHICLES = {
    "hummingbird": ("flight_breeze", ("adrc-paper", "flatness", "lqg", "apg-flight-0")),
    "paper": ("windy", ("adrc-paper", "flatness", "lqg", "apg-0")),
}
HEIGHT = 2.0  # m, of the vehicle at its target
GAIN_STEPS = (0, 1, 2, 4, 9, 22, 99)  # fewer than in firmware make the page smaller
_COMPILE = ("clang", "--target=wasm32", "-nostdlib", "-mbulk-memory", "-Oz", "-DQUADPEND_DOUBLE", "-DQUADPEND_NO_LIBM")
_LINK = ("-Wl,--no-entry,--strip-all", *(f"-Wl,--export={name}" for name in ("data_of", "restart", "advance")))
_EQUATIONS = re.compile(r"static (void (\w+)\([^)]*\)) \{\n  real w0.*?\n\}\n", re.DOTALL)  # functions of `scalar_c`
_TABLES = re.compile(r"static const [^;]*;")
_SECTION = b"\x06source"  # name of the section with the hash, after its length


def design(vehicle: str) -> Scenario:
    """Return the scenario for which the policies of a vehicle are designed, with the observation of C."""
    name = VEHICLES[vehicle][0]
    return replace(find_scenarios([name])[name], observation=LAB)


def flown(vehicle: str, **wind: Any) -> Scenario:
    """Return the scenario that is flown on the page, in a constant wind: hover, no velocities, no noise."""
    hover = find_scenarios(["flight_breeze"])["flight_breeze"].task
    plain: dict[str, Any] = {
        "sensors": (),
        "actuators": (),
        "wind_rise": 0.0,
        "unscored": 0.0,
    }
    return replace(design(vehicle), task=hover, wind={"kind": "constant", **wind}, **plain)


def write_c(vehicle: str, folder: Path) -> str:
    """Write the C of a vehicle with its policies into a folder, functions that several have once; return its hash."""
    shared: dict[str, str] = {}

    def share(match: re.Match[str]) -> str:
        name = f"{match[2]}_{hashlib.sha256(match[0].encode()).hexdigest()[:8]}"
        shared[name] = match[0].removeprefix("static ").replace(match[2], name, 1)
        return f"{match[1].replace(match[2], name, 1)};\n#define {match[2]} {name}\n"

    sources = [_vehicle_c(vehicle)]
    (folder / "vehicle.c").write_text(sources[0], encoding="utf-8")
    for name in VEHICLES[vehicle][1]:
        path = folder / f"{_stem(name)}.c"
        source, header, _ = to_c.export_c(load_policy(name), name, design(vehicle), path, GAIN_STEPS)
        path.with_name(f"{path.stem}_check.c").unlink()
        sources += [path.read_text(encoding="utf-8"), header.read_text(encoding="utf-8")]
        source.write_text(_EQUATIONS.sub(share, sources[-2]), encoding="utf-8")
    head = re.sub(r'#include ".*?"\n', "", sources[0].partition("#define MEMORY")[0])
    (folder / "shared.c").write_text(head + "\n".join(shared.values()), encoding="utf-8")
    written = _TABLES.sub("", _EQUATIONS.sub("", "".join(sources)))
    return hashlib.sha256(written.encode()).hexdigest()


def compile_wasm(vehicle: str) -> None:
    """Write the .wasm file of a vehicle."""
    target = FOLDER / f"{vehicle}.wasm"
    with tempfile.TemporaryDirectory() as name:
        found = write_c(vehicle, Path(name))
        subprocess.run([*_COMPILE, *_LINK, *sorted(Path(name).glob("*.c")), "-o", target], check=True)
    section = _SECTION + found.encode()
    target.write_bytes(target.read_bytes() + bytes([0, len(section)]) + section)


def compiled_hash(vehicle: str) -> str:
    """Return the hash in the .wasm file of a vehicle."""
    return (FOLDER / f"{vehicle}.wasm").read_bytes().rpartition(_SECTION)[2].decode()


def _stem(name: str) -> str:
    return name.replace("-", "_")


def _numbers(values: Any) -> str:
    return ", ".join(f"R({float(value)!r})" for value in values)


def _vehicle_c(vehicle: str) -> str:
    simulation, stems = design(vehicle).simulation, [_stem(name) for name in VEHICLES[vehicle][1]]
    start = np.zeros((1, STATE_SIZE))
    start[0, [POSITION + 2, DIRECTION + 2]] = HEIGHT, 1.0
    target = np.append(start[0, POSITION : POSITION + 3], np.zeros(21))
    parameters, plant = simulation.parameters.as_array(), step_function(simulation)
    state, memory, action = (ca.SX.sym(name, plant.numel_in(name)) for name in ("state", "memory", "action"))
    wind = ca.SX.sym("wind", 6)
    after = plant(state, memory, action, ca.vertcat(wind, ca.SX.zeros(6)), parameters)
    attitude = vector(lift(quaternion_from_euler)(lift(load)(columns(state), EULER, 0)))
    sample = ca.vertcat(state[POSITION : POSITION + 3], attitude, state[DIRECTION : DIRECTION + 3], 0.0)
    _, error = observation_function()(state, parameters, target)
    functions = (
        ca.Function(
            "step",
            [state, memory, action, wind],
            [ca.densify(x) for x in after],
            ["state", "memory", "action", "wind"],
            ["next_state", "next_memory"],
        ),
        ca.Function("measure", [state], [sample, error], ["state"], ["sample", "error"]),
    )
    memory_start = initial_memory(simulation, start)[0]
    cases = [
        f"    case {k}:\n      if (starts) {stem}_reset(&policy_{k});\n"
        f"      {stem}_step(&policy_{k}, (void *)sample, (const void *)TARGET, (void *)command);\n      break;"
        for k, stem in enumerate(stems)
    ]
    values = {
        "includes": "\n".join(f'#include "{stem}.h"' for stem in stems),
        "elementary": Path(to_c.__file__).with_name("elementary.c").read_text(encoding="utf-8").strip(),
        "memory": len(memory_start),
        "state": _numbers(start[0]),
        "memory_start": _numbers([*memory_start, 0.0]),
        "scale": _numbers(simulation.command_scale),
        "target": _numbers([*target, *parameters[[ROD_LENGTH, BOB_MASS]]]),
        "functions": "\n".join(scalar_c(function) for function in functions),
        "policies": "\n".join(f"static {stem}_policy policy_{k};" for k, stem in enumerate(stems)),
        "cases": "\n".join(cases),
    }
    template = (FOLDER / "vehicle.c").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), template)


def page() -> str:
    """Return the page, which needs no other file."""
    jinja = Environment(loader=FileSystemLoader(FOLDER), undefined=StrictUndefined, autoescape=True)
    data = {vehicle: _page_data(vehicle) for vehicle in VEHICLES}
    return jinja.get_template("flying.html").render(data=Markup(json.dumps(data)))


def _page_data(vehicle: str) -> dict[str, Any]:
    scenario, (_, policies) = design(vehicle), VEHICLES[vehicle]
    (wind,), limits = wind_models(scenario.wind, scenario.simulation), flown(vehicle).task.limits
    parameters, shape = scenario.simulation.parameters, shape_of(scenario.vehicle)
    return {
        "policies": [{"name": name, **html_page.style(k)} for k, name in enumerate(policies)],
        "period": scenario.simulation.period,
        "height": HEIGHT,
        "push": [0.2 * parameters.hover_thrust, 0.4 * parameters.gravity * parameters.bob_mass],  # N, the largest ones
        "wind": {"force": wind.force, "decay": float(np.exp(-scenario.simulation.period / wind.time_constant))},
        "limits": [np.cos(limits.pendulum_angle), np.cos(limits.body_angle), limits.tracking_error],
        "rod_length": parameters.rod_length,
        "shape": {
            **{name: np.asarray(size).tolist() for name, size in shape._asdict().items()},
            "paper": shape is PAPER_SHAPE,
        },
        "wasm": base64.b64encode(gzip.compress((FOLDER / f"{vehicle}.wasm").read_bytes(), 9, mtime=0)).decode(),
    }


if __name__ == "__main__":
    for name in VEHICLES:
        compile_wasm(name)
