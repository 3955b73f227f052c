"""The flying page: a vehicle that flies in the browser, from the C of `quadpend_gym.engines` and `quadpend export`.

    python -m docs.tools.flying_page  # write docs/flying.html, which needs no other file; needs clang and wasm-ld

The WebAssembly in the page ends with a hash of its C without tables and functions of the equations, whose form and last
digits depend on the computer. Tests compare it, the rest of the page, and flights with those of Python.
"""

import base64
import csv
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
from quadpend_gym.envs.loops import Schedule
from quadpend_gym.physics.attitude import quaternion_from_euler
from quadpend_gym.physics.state import DIRECTION, EULER, POSITION, STATE_SIZE
from quadpend_gym.physics.vectors import load
from quadpend_gym.randomization import LoopRanges
from quadpend_gym.scenarios import SCENARIOS
from quadpend_gym.tasks.observation import LAB
from quadpend_gym.tasks.references import POINT_SIZE
from quadpend_gym.vehicles.parameters import BOB_MASS, PARAMETERS_SIZE, ROD_LENGTH
from quadpend_gym.viewer.snapshot import shape_of
from quadpend_gym.wind.hand import Hold
from quadpend_train.evaluation.envelope import DELAY
from quadpend_train.export import to_c
from quadpend_train.policies.loading import load_policy
from quadpend_train.reports import html_page

FOLDER = Path(__file__).with_name("flying")
PAGE = Path(__file__).parents[1] / "flying.html"
LIMITS = Path(__file__).parents[1] / "flight" / "limits.csv"  # data sheets
DESIGN = replace(SCENARIOS["flight_breeze"], observation=LAB)  # the scenario for which the policies are designed
# Policies, with their names in the data sheets. The page begins with the first two.
POLICIES = {
    "lqg": "lqg",
    "apg-flight-0": "apg-flight",
    "lab-0": "lab",
    "flatness": "flatness",
    "adrc-paper": "adrc-paper",
}
# Events of the page, with their names in the data sheet; the last one is set by a slider
EVENTS = {
    "jump": "jump of the set-point",
    "blind": "drop-outs each second",
    "hand": "held pole let go",
    "pole": "pole not as believed",
    "delay": DELAY,
}
HEIGHT = 2.0  # m, of the vehicle at its target
LONGEST_DELAY = 0.05  # s, beyond the latency
GAIN_STEPS = (0, 1, 2, 4, 9, 22, 99)  # fewer than in firmware make the page smaller
_COMPILE = ("clang", "--target=wasm32", "-nostdlib", "-mbulk-memory", "-Oz", "-DQUADPEND_DOUBLE", "-DQUADPEND_NO_LIBM")
_LINK = ("-Wl,--no-entry,--strip-all", *(f"-Wl,--export={name}" for name in ("data_of", "restart", "advance")))
_EQUATIONS = re.compile(r"static (void (\w+)\([^)]*\)) \{\n  real w0.*?\n\}\n", re.DOTALL)  # functions of `scalar_c`
_TABLES = re.compile(r"static const [^;]*;")
_SECTION = b"\x06source"  # name of the section with the hash, after its length


def flown(**changes: Any) -> Scenario:
    """Return the scenario that is flown on the page, without wind and noise."""
    still: dict[str, Any] = {"wind": (), "sensors": (), "actuators": (), "wind_rise": 0.0, "unscored": 0.0}
    return replace(DESIGN, **still | changes)


def write_c(folder: Path) -> str:
    """Write the C of the page into a folder, functions that several policies have once; return its hash."""
    shared: dict[str, str] = {}
    called: dict[str, str] = {}  # names of functions that later ones of a file may call

    def share(match: re.Match[str]) -> str:
        text = re.sub(r"\b(\w+)(?=\(x, y\);)", lambda call: called[call[0]], match[0])
        name = f"{match[2]}_{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        shared[name], called[match[2]] = text.removeprefix("static ").replace(match[2], name, 1), name
        return f"{match[1].replace(match[2], name, 1)};\n#define {match[2]} {name}\n"

    sources = [_vehicle_c()]
    (folder / "vehicle.c").write_text(sources[0], encoding="utf-8")
    for name in POLICIES:
        path = folder / f"{_stem(name)}.c"
        source, header, _ = to_c.export_c(load_policy(name), name, DESIGN, path, GAIN_STEPS)
        path.with_name(f"{path.stem}_check.c").unlink()
        sources += [path.read_text(encoding="utf-8"), header.read_text(encoding="utf-8")]
        source.write_text(_EQUATIONS.sub(share, sources[-2]), encoding="utf-8")
    head = re.sub(r'#include ".*?"\n', "", sources[0].partition("#define MEMORY")[0])
    (folder / "shared.c").write_text(head + "\n".join(shared.values()), encoding="utf-8")
    written = _TABLES.sub("", _EQUATIONS.sub("", "".join(sources)))
    return hashlib.sha256(written.encode()).hexdigest()


def compile_wasm() -> bytes:
    """Return the WebAssembly of the page, with the hash of its C."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        section = _SECTION + write_c(folder).encode()
        target = folder / "vehicle.wasm"
        subprocess.run([*_COMPILE, *_LINK, *sorted(folder.glob("*.c")), "-o", target], check=True)
        return target.read_bytes() + bytes([0, len(section)]) + section


def compiled() -> bytes:
    """Return the WebAssembly in the page on disk."""
    packed = PAGE.read_text(encoding="utf-8").partition('"wasm": "')[2].partition('"')[0]
    return gzip.decompress(base64.b64decode(packed))


def compiled_hash() -> str:
    """Return the hash of the C in the page on disk."""
    return compiled().rpartition(_SECTION)[2].decode()


def _stem(name: str) -> str:
    return name.replace("-", "_")


def _numbers(values: Any) -> str:
    return ", ".join(f"R({float(value)!r})" for value in values)


def _vehicle_c() -> str:
    simulation, stems = DESIGN.simulation, [_stem(name) for name in POLICIES]
    loop = LoopRanges(latency=(simulation.latency, simulation.latency + LONGEST_DELAY))
    start = np.zeros((1, STATE_SIZE))
    start[0, [POSITION + 2, DIRECTION + 2]] = HEIGHT, 1.0
    plant = step_function(simulation, ranges=loop, holds=True)
    sizes = {name: plant.size1_in(name) for name in ("state", "memory", "action", "loop", "hand")}
    state, memory, action, loops, hand = (ca.SX.sym(name, size) for name, size in sizes.items())
    wind, target, parameters = (
        ca.SX.sym(name, size) for name, size in (("wind", 6), ("target", 3), ("parameters", PARAMETERS_SIZE))
    )
    after = plant(state, memory, action, ca.vertcat(wind, ca.SX.zeros(6)), parameters, loops, hand)
    attitude = vector(lift(quaternion_from_euler)(lift(load)(columns(state), EULER, 0)))
    sample = ca.vertcat(state[POSITION : POSITION + 3], attitude, state[DIRECTION : DIRECTION + 3], 0.0)
    point = ca.vertcat(target, ca.SX.zeros(POINT_SIZE - 3))
    _, error = observation_function()(state, parameters, point)
    functions = (
        ca.Function(
            "step",
            [state, memory, action, wind, parameters, loops, hand],
            [ca.densify(x) for x in after],
            ["state", "memory", "action", "wind", "parameters", "loop", "hand"],
            ["next_state", "next_memory"],
        ),
        ca.Function(
            "measure",
            [state, parameters, target],
            [sample, error],
            ["state", "parameters", "target"],
            ["sample", "error"],
        ),
    )
    memory_start = initial_memory(simulation, start, loop)[0]
    cases = [
        f"    case {k}:\n      if (starts) {stem}_reset(&policy_{k});\n"
        f"      {stem}_step(&policy_{k}, data.sees ? (void *)sample : 0, (void *)reference, (void *)command);\n"
        f"      break;"
        for k, stem in enumerate(stems)
    ]
    values = {
        "includes": "\n".join(f'#include "{stem}.h"' for stem in stems),
        "elementary": Path(to_c.__file__).with_name("elementary.c").read_text(encoding="utf-8").strip(),
        "memory": len(memory_start),
        "state": _numbers(start[0]),
        "memory_start": _numbers(memory_start),
        "loop": sizes["loop"],
        "scale": _numbers(simulation.command_scale),
        "pole": _numbers(simulation.parameters.as_array()[[ROD_LENGTH, BOB_MASS]]),
        "functions": "\n".join(scalar_c(function) for function in functions),
        "policies": "\n".join(f"static {stem}_policy policy_{k};" for k, stem in enumerate(stems)),
        "cases": "\n".join(cases),
    }
    template = (FOLDER / "vehicle.c").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), template)


def page(wasm: bytes) -> str:
    """Return the page with its WebAssembly."""
    jinja = Environment(loader=FileSystemLoader(FOLDER), undefined=StrictUndefined, autoescape=True)
    packed = base64.b64encode(gzip.compress(wasm, 9, mtime=0)).decode()
    data = _rounded({**_page_data(), "wasm": packed})
    return jinja.get_template("flying.html").render(data=Markup(json.dumps(data)), events=EVENTS) + "\n"


def loops() -> list[list[float]]:
    """Return the loop of the vehicle for each extra delay, in substeps."""
    simulation = DESIGN.simulation
    substep = simulation.period / simulation.substeps
    delays = [substep * k for k in range(round(LONGEST_DELAY / substep) + 1)]
    late = (replace(simulation, latency=simulation.latency + delay) for delay in delays)
    return [Schedule(None, each, 1).loops[:, 0].tolist() for each in late]


def _page_data() -> dict[str, Any]:
    simulation, limits, shape = DESIGN.simulation, DESIGN.task.limits, shape_of(DESIGN.vehicle)
    (wind,), parameters = DESIGN.wind, simulation.parameters
    rows = [*csv.DictReader(LIMITS.read_text(encoding="utf-8").splitlines())]
    found = {(row["policy"], row["event"]): float(row["limit"]) for row in rows}
    units = {row["event"]: {"unit": row["unit"], "everyday": float(row["everyday"])} for row in rows}
    hand = next(model for model in SCENARIOS["event_catch"].wind if isinstance(model, Hold))
    return {
        "policies": [
            {
                "name": name,
                "limits": {key: found[sheet, event] for key, event in EVENTS.items()},
                **html_page.style(k),
            }
            for k, (name, sheet) in enumerate(POLICIES.items())
        ],
        "events": {key: units[event] for key, event in EVENTS.items()},
        "hand": {name: getattr(hand, name) for name in ("stiffness", "damping", "until")},
        "parameters": parameters.as_array(),
        "grown": [BOB_MASS, ROD_LENGTH],
        "loops": loops(),
        "delay": 1000.0 * simulation.period / simulation.substeps,  # ms, of a step of the slider
        "period": simulation.period,
        "height": HEIGHT,
        "push": [0.2 * parameters.hover_thrust, 0.4 * parameters.gravity * parameters.bob_mass],  # N, the largest ones
        "wind": {"force": wind.force, "decay": float(np.exp(-simulation.period / wind.time_constant))},
        "limits": [np.cos(limits.pendulum_angle), np.cos(limits.body_angle), limits.tracking_error],
        "shape": shape._asdict(),
    }


def _rounded(value: Any) -> Any:
    """Return a value for JSON, in which the last digits of numbers do not depend on the computer."""
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_rounded(each) for each in value]
    return float(f"{value:.12g}") if isinstance(value, float) else value


if __name__ == "__main__":
    PAGE.write_text(page(compile_wasm()), encoding="utf-8")
