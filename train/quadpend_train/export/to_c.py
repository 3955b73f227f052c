"""Policies as C: one source, one header, and golden vectors with a program that checks them.

`program` reads the equations; the templates, ``policy.c`` and the other files of C, stand beside this file.
"""

import re
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from quadpend_baselines import Policy
from quadpend_baselines.estimation.estimate import AGE, HELD, INNOVATION
from quadpend_baselines.estimation.feeding import FedErrors
from quadpend_baselines.estimation.kalman import Estimator
from quadpend_baselines.estimation.samples import COASTS, EARLY, GATES, MOST_REFUSED, REPEATS
from quadpend_gym.core.arrays import Floats, Floats32
from quadpend_gym.engines import scalar_c
from quadpend_gym.scenarios import Scenario, find_scenarios
from quadpend_gym.sensors import Delay
from quadpend_gym.tasks.observation import LAB, OUTPUT_FEEDBACK_SIZE
from quadpend_gym.tasks.task import Limits
from quadpend_gym.vehicles import VEHICLES
from quadpend_train.common.files import atomic
from quadpend_train.export.program import program
from quadpend_train.policies.compiled import samples_of
from quadpend_train.policies.mlp_policy import MlpPolicy

_FOLDER = Path(__file__).parent
_STEPS = 100  # golden vectors
# Rows of its table from which on a gain of the Kalman filter, in single precision, is used: 20 at the beginning, the
# steady one, and those after coasts
GAIN_STEPS = (*range(10), 11, 13, 15, 18, 22, 27, 34, 43, 55, 72, 99, 100, 101, 103, 105, 109, 114, 121)
_ACTIVATIONS = {"relu": "q_max({0}, 0)", "tanh": "q_tanh({0})", "elu": "{0} > 0 ? {0} : q_exp({0}) - 1"}
_CEILING = 10.0  # m, above the ground
# Limits of a supervisor that no task has. Innovations are twice the noise of the flight benchmark, which they reach in
# none of its gentle flights; caution is set by hand
_SUPERVISED = {
    "speed": 5.0,
    "age": REPEATS,
    "caution": 0.25,
    "innovation": (0.001, 0.002, 0.0012),
    "set_point": (1.0, 1.0),
    "yaw": (0.5, 0.5),
}
_HOLDS = "the latest one is held"
_PREDICTS = "the observer\n * predicts"


def export_c(
    policy: Policy, name: str, scenario: Scenario, out: Path, gain_steps: Sequence[int] = GAIN_STEPS
) -> list[Path]:
    """Write a policy as C, for the vehicle, the interface, the period and the latency of a scenario.

    Args:
        policy: The policy, not adapted.
        name: Its name, for comments.
        scenario: The scenario, with the observation ``"lab"``.
        out: The source to write; the header and the golden vectors (``_check.c``) are written beside it.
        gain_steps: Corrections from which on a gain of the Kalman filter is used.

    Returns:
        The three files.

    Raises:
        ValueError: The policy or the scenario cannot be written as C.
    """
    stem = out.stem
    if out.suffix != ".c" or not re.fullmatch(r"[A-Za-z]\w*", stem, re.ASCII):
        raise ValueError(f"the name of a C file must be letters, digits and _, and end with .c, not {out.name!r}")
    scenario = replace(scenario, observation=LAB, pole_told=False)  # a C file is for the pole of the vehicle
    adapted = adapt(policy, name, scenario, gain_steps)
    inner, read = _inner(adapted)
    simulation, found = scenario.simulation, program(inner, scenario.simulation, read)
    scale, is_network, reads_observer = simulation.command_scale, isinstance(inner, MlpPolicy), bool(found.checked)
    functions = dict(found.functions)
    tables, layers = "", ""
    if reads_observer:
        tables += _gain_tables(_observer(inner), gain_steps)
    if isinstance(inner, MlpPolicy):
        more, network_tables, layers = _network(inner)
        functions, tables = {**functions, **more}, tables + network_tables
    turning = {"body_rates": ("rate", "rad/s"), "wrench": ("torque", "N m")}[simulation.interface]
    vehicle, about = simulation.vehicle.name, (scenario.name, scenario.description)
    values = {
        "name": stem,
        "title": f"{out.with_suffix('.h').name}: the policy {name} for the vehicle {vehicle}.",
        "description": f"It is designed for the scenario {': '.join(filter(None, about))}.",
        "period": repr(simulation.period),
        "latency": repr(simulation.latency),
        "interface": simulation.interface,
        "vehicle": vehicle,
        "turning": turning[0],
        "turning_unit": turning[1],
        "most_thrust": f"{2.0 * scale[0]:.6g}",
        "limits": ", ".join(f"{limit:.6g}" for limit in scale[1:]),
        "missing": _PREDICTS if reads_observer else _HOLDS,
        "elementary": (_FOLDER / "elementary.c").read_text(encoding="utf-8").strip(),
        "kalman": int(reads_observer),
        "adrc": int("release" in found.functions),
        "network": int(is_network),
        "memory": found.memory,
        "extra": found.extra,
        "read": found.functions["observe"].size1_out(0) if is_network else 0,
        "estimate": found.estimate,
        "parts": len(found.parts),
        "checked": found.checked,
        "limit": found.limit,
        "scale": _numbers(scale),
        "units": _numbers(LAB.scale),
        "pole": f"{simulation.parameters.rod_length!r}, {simulation.parameters.bob_mass!r}",
        "tables": tables,
        "functions": "\n".join(scalar_c(function) for function in functions.values()),
        "advances": ", ".join(found.parts),
        "layers": layers,
        "steps": _STEPS,
        "tolerance": "1e-2" if _is_fast(inner) else "1e-4",
        "tolerance_double": "1e-6" if _is_rounded(inner) else "6e-8",  # one unit of a float32
        "vectors": _vectors(adapted, scenario),
        "ranges": _numbers(2.0 * scale),
        "gates": ", ".join(f"{{{_numbers(gate)}}}" for gate in GATES),
        "most_refused": MOST_REFUSED,
        "supervised": _limits(scenario.task.limits),
    }
    files = {
        ("policy.c", "supervisor.c"): out,
        ("policy.h",): out.with_suffix(".h"),
        ("check.c",): out.with_name(f"{stem}_check.c"),
    }
    for templates, path in files.items():
        text = "".join((_FOLDER / template).read_text(encoding="utf-8") for template in templates)
        with atomic(path) as unfinished:
            filled = re.sub(r"@(\w+)@", lambda match: str(values[match[1]]), text)
            unfinished.write_text(filled, encoding="utf-8")
    return list(files.values())


def adapt(policy: Policy, name: str, scenario: Scenario, gain_steps: Sequence[int] = GAIN_STEPS) -> Any:
    """Return the policy for a scenario, with the gains and the precision of its C file."""
    trained = policy.card.get("settings", {}).get("scenarios", ()) if isinstance(policy, MlpPolicy) else ()
    tasks = [scenario.task, *(item.task for item in find_scenarios(trained).values())]
    if any(task.pendulum != "upright" or task.limits.pendulum_angle > 0.5 * np.pi for task in tasks):
        raise ValueError(f"{name} cannot be written as C: only policies that balance an upright pendulum can")
    if not (isinstance(policy, MlpPolicy) or getattr(policy, "has_c", False)):
        raise ValueError(
            f"{name} cannot be written as C: it is no feedforward network, ADRC, LQR, LQI, LQG, flatness or dual-mode"
        )
    if scenario.simulation.interface == "rotors":
        raise ValueError("C files command thrust with torques or body rates: choose another --scenario without rotors")
    if any(isinstance(model, Delay) for model in scenario.sensors):
        raise ValueError("C files predict no delay of sensors: choose another --scenario, with a latency in its place")
    adapted = copy(policy).adapt(scenario)
    inner, _ = _inner(adapted)
    if isinstance(inner, MlpPolicy):
        setattr(inner, "forward", _double_forward(inner))  # noqa: B010
    if (observer := _observer(inner)) is not None:
        thinned = tuple(
            table[_gain_rows(len(table), gain_steps)].astype(np.float32).astype(float) for table in observer.tables
        )
        observer.__dict__["tables"] = thinned
    return adapted


def scenario_for(policy: Policy, name: str) -> str:
    """Return the scenario for which a policy is written by default: with the interface and the vehicle of its card."""
    card = getattr(policy, "card", None) or {}
    interface, vehicle = card.get("interface"), card.get("vehicle")
    scenario, usual = {"wrench": ("windy", "paper")}.get(str(interface), ("flight_breeze", "hummingbird"))
    if vehicle in (None, "any", usual):
        return scenario
    if interface == "body_rates" and vehicle in VEHICLES:
        return f"{scenario}@{vehicle}"
    raise ValueError(f"{name} commands {interface} of the vehicle {vehicle}: give a --scenario with both")


def _inner(adapted: Any) -> tuple[Any, list[int]]:
    """Return a policy, and the columns of the observation of errors, or of `LAB`, that it reads."""
    read: Any = slice(None)
    if isinstance(adapted, FedErrors):
        adapted, read = adapted.policy, adapted.read
    hybrid = getattr(adapted, "hybrid", None)
    size = LAB.size if hybrid is not None and hybrid.reads == "lab" else OUTPUT_FEEDBACK_SIZE
    return adapted, np.arange(size)[read].tolist()


def _base(policy: Any) -> Any:
    """Return the base controller of a hybrid that flies, or None."""
    hybrid = getattr(policy, "hybrid", None)
    return None if hybrid is None or hybrid.controller.observer == "none" else hybrid.controller


def _is_fast(policy: Any) -> bool:
    """Return whether observers amplify the rounding of the measurement."""
    base = _base(policy) if isinstance(policy, MlpPolicy) else policy
    if getattr(base, "observer", "none") != "deso":
        return False
    return bool(max(gains.bandwidth for _, gains in base.estimator.observers) * base.simulation.period > 1.0)


def _is_rounded(policy: Any) -> bool:
    """Return whether a difference in the last digit of double precision is one in that of single precision."""
    hybrid = getattr(policy, "hybrid", None)
    return _is_fast(policy) or (hybrid is not None and hybrid.kind != "estimate_only")


def _observer(policy: Any) -> Any:
    """Return the Kalman observer of a policy; None without one."""
    base = _base(policy) if isinstance(policy, MlpPolicy) else policy
    return base.estimator if getattr(base, "observer", "none") == "kalman" else None


def _double_forward(policy: MlpPolicy) -> Any:
    """Return the network's function in double precision, from and to single precision."""
    double = copy(policy)
    double.layers = [(weights.astype(float), biases.astype(float)) for weights, biases in policy.layers]

    def forward(inputs: Floats32) -> Floats32:
        return MlpPolicy.forward(double, inputs.astype(float)).astype(np.float32)

    return forward


def _gain_rows(steps: int, gain_steps: Sequence[int]) -> Any:
    """Return for each correction the step whose gain is used."""
    used = np.array(gain_steps)
    return used[np.searchsorted(used, np.arange(steps), side="right") - 1]


def _gain_tables(observer: Estimator, gain_steps: Sequence[int]) -> str:
    every = observer.tables[0]
    used_rows = np.searchsorted(gain_steps, _gain_rows(len(every), gain_steps))
    table = every[:, every.any(axis=0)][list(gain_steps)]
    return (
        f"#define AGE {AGE}\n#define HELD {HELD}\n#define INNOVATION {INNOVATION}\n#define EARLY {EARLY}\n"
        f"#define COASTS {COASTS}\n#define FIRST_COAST {len(every) - COASTS}\n"
        f"static const unsigned char gain_rows[{len(used_rows)}] = {{\n{_lines(map(str, used_rows))}}};\n"
        f"static const real gains[{len(table)}][{table[0].size}] = {{\n"
        + ",\n".join(f"{{{_numbers(gain.ravel())}}}" for gain in table)
        + "};\n"
    )


def _network(policy: MlpPolicy) -> tuple[dict[str, Any], str, str]:
    """Return functions, tables and calls of a network."""
    card, layers = policy._card, policy.layers
    count = len(layers[0][0]) // (1 + len(policy.input_scales))
    x, y = ca.SX.sym("inputs", count), ca.SX.sym("last", 4)
    scaled = x
    if (normalization := card.normalization) is not None:
        scaled = (x - np.array(normalization.mean)) / np.array(normalization.std)
        scaled = ca.fmin(ca.fmax(scaled, -normalization.clip), normalization.clip)
    scaled = ca.vertcat(scaled, *(ca.tanh(scale * scaled) for scale in policy.input_scales))
    out = y if card.bound is None else ca.fmin(ca.fmax(y, -card.bound), card.bound)
    out = ca.tanh(out) if card.squashed else ca.fmin(ca.fmax(out, -1.0), 1.0)
    functions = {
        "features": ca.Function("features", [x], [scaled], ["inputs"], ["features"]),
        "finish": ca.Function("finish", [y], [out], ["last"], ["output"]),
    }
    lines = [f"real x[INPUTS], layer_0[{len(layers[0][0])}];"]
    lines += ["for (int i = 0; i < INPUTS; ++i) x[i] = single(inputs[i]);"]
    lines += ["features(x, layer_0);"]
    tables = f"#define INPUTS {count}\n"
    for i, (weights, biases) in enumerate(layers):
        rows, columns = weights.shape
        tables += f"static const float weights_{i}[{rows * columns}] = {{\n{_numbers(weights.T.ravel())}}};\n"
        tables += f"static const float biases_{i}[{columns}] = {{\n{_numbers(biases)}}};\n"
        lines.append(f"real layer_{i + 1}[{columns}];")
        lines.append(f"dense({rows}, {columns}, weights_{i}, biases_{i}, layer_{i}, layer_{i + 1});")
        if i < len(layers) - 1:
            value = _ACTIVATIONS[card.activation].format(f"layer_{i + 1}[i]")
            lines.append(f"for (int i = 0; i < {columns}; ++i) layer_{i + 1}[i] = {value};")
    lines.append(f"finish(layer_{len(layers)}, output);")
    return functions, tables, "\n".join(f"  {line}" for line in lines)


def _vectors(policy: Policy, scenario: Scenario) -> str:
    """Return measurements, references and commands of a flight."""
    envs, memory, rows = scenario.make_vec(1), None, []
    observation, _ = envs.reset(seed=0)
    scale = scenario.simulation.command_scale
    for step in range(_STEPS):
        action, memory = policy.predict(observation, memory, np.array([step == 0]))
        sample = samples_of(observation)[0]
        command = scale * action[0].astype(float) + [scale[0], 0.0, 0.0, 0.0]
        rows.append(f"  {{{_numbers([*sample, *command])}}}")
        observation, *_ = envs.step(action)
    return ",\n".join(rows)


def _limits(limits: Limits) -> str:
    """Return the limits of a supervisor: those of a task, with those that no task has."""
    found = {
        "pole_tilt": limits.pendulum_angle,
        "body_tilt": limits.body_angle,
        "distance": limits.tracking_error,
        "height": (limits.ground, limits.ground + _CEILING),
        **_SUPERVISED,
    }
    texts = (
        f"{{{', '.join(map(repr, value))}}}" if isinstance(value, tuple) else repr(value) for value in found.values()
    )
    return ", ".join(f".{name} = {text}" for name, text in zip(found, texts, strict=True))


def _numbers(values: Iterable[float] | Floats) -> str:
    return _lines(f"R({float(value)!r})" for value in values)


def _lines(texts: Iterable[str]) -> str:
    """Return texts between commas, in lines of at most 120 characters."""
    lines = [""]
    for text in texts:
        if len(lines[-1]) + len(text) > 116:
            lines.append("")
        lines[-1] += f"{text}, "
    return "\n".join(lines).removesuffix(", ")
