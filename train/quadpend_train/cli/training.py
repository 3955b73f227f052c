"""The commands about learned policies: `train` and `export`."""

import json
import re
import shlex
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from quadpend_train.cli.options import Latency, named_scenarios
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import (
    PRESETS,
    TrainSettings,
    read_settings,
    scenario_text,
    with_values,
)

DEFAULT_OUT = Path("runs/latest")


def default_settings(options: Sequence[str]) -> dict[str, Any]:
    """Return the settings whose values are the defaults of the options of `train`, as its parameter `run`.

    They follow from some of the options, which are read here before the parser knows the defaults.
    """
    settings, algo, resume, start_from = (
        (_values_of(options, name) or [""])[-1] for name in ("settings", "algo", "resume", "start-from")
    )
    changes = _values_of(options, "set")
    if not resume:
        return {"run": with_values(_base(settings, algo, start_from), _changed_values(changes))}
    if settings or changes:
        raise ValueError("--resume continues a run with its own settings: give no --settings and no --set with it")
    stored = Path(resume) / "settings.json"
    return {"run": read_settings(str(stored) if stored.is_file() else "ppo")}


def _values_of(options: Sequence[str], name: str) -> list[str]:
    """Return the values of an option, as ``--name VALUE`` or ``--name=VALUE``."""
    found: list[str] = []
    for option, after in zip(options, [*options, ""][1:], strict=True):
        given, sign, value = option.partition("=")
        if given.startswith("--") and given[2:].replace("_", "-") == name:
            found.append(value if sign else after)
    return found


def _base(settings: str, algo: str, start_from: str) -> TrainSettings:
    """Return the settings of a file, of the algorithm's preset, or of the policy that training starts from."""
    from quadpend_train.policies.loading import policy_file

    if algo and not settings and not (PRESETS / f"{algo}.toml").is_file():
        return replace(read_settings("sac"), algo=algo) if algo == "tqc" else TrainSettings(algo=algo)
    if start_from and not settings and not algo:
        with suppress(ValueError):  # training refuses the policy with its own message
            return read_settings(str(policy_file(start_from)))
    return read_settings(settings or algo or "ppo")


def _changed_values(changes: Sequence[str]) -> dict[str, Any]:
    """Return the values of changes such as ``ppo.learning_rate=1e-3`` by their paths; they are JSON or text."""
    values: dict[str, Any] = {}
    for change in changes:
        path, sign, text = change.partition("=")
        if not sign:
            raise ValueError(f"--set takes TABLE.NAME=VALUE, such as ppo.learning_rate=1e-3, not {change!r}")
        try:
            values[path] = json.loads(text)
        except json.JSONDecodeError:
            values[path] = text
    return values


def train(
    run: Annotated[TrainSettings, tyro.conf.arg(name="")],
    settings: str | None = None,
    set: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    out: Path = DEFAULT_OUT,
    resume: Path | None = None,
    vehicle: str | None = None,
    interface: str | None = None,
) -> None:
    """Train a policy.

    Args:
        run: Settings that replace those of the file.
        settings: A preset, a TOML or JSON file, or a policy file (.npz), whose card contains the settings of its
            training. Without it, --algo selects the preset ppo, sac or apg, and --start-from the settings of its
            policy.
        set: A keyword argument of the algorithm's class, as ppo.learning_rate=1e-3 or
            sac.policy_kwargs.net_arch=[64,64]. It may be repeated.
        out: Folder of the run.
        resume: Folder of an interrupted run to continue with its own settings; only --max-seconds may be changed.
            Loading its checkpoint executes code that it contains: resume only runs that you trust.
        vehicle: Vehicle of all scenarios, as in evaluate.
        interface: What the actions command in all scenarios: wrench, rotors or body_rates.
    """
    from quadpend_train.training import train as training

    if resume:
        if vehicle or interface or out != DEFAULT_OUT:
            raise ValueError(
                "--resume continues a run with its own scenarios in its own folder: give no --vehicle, no --interface"
                " and no --out with it"
            )
        print(f"Loading the models in {resume} executes code that they contain: resume only runs that you trust.")
    given: list[str] = []
    if vehicle or interface:
        options = {"--vehicle": vehicle, "--interface": interface}
        texts = map(scenario_text, run.scenarios)
        given = [*texts, *(part for name, value in options.items() if value for part in (name, value))]
        run = replace(run, scenarios=named_scenarios(run.scenarios, vehicle, interface).values())
    path = training.resume(resume, run) if resume else training.train(run, out)
    score = MlpPolicy.load(path).card["score"]
    print(
        f"Trained policy: {path}\nIn its training scenarios it survives {score['survival']:.1%} of the episodes;"
        f" penalised RMSE {1e3 * score['penalised_rmse']:.1f} mm."
    )
    command = ["quadpend", "evaluate", "flatness", f"mine={path.parent}", "--scenarios"]
    print("Compare with a classical controller:", shlex.join(command + (given or [*map(scenario_text, run.scenarios)])))


def export(
    model: tyro.conf.Positional[str],
    to: Literal["npz", "c"] = "npz",
    out: Path | None = None,
    vec_normalize: Path | None = None,
    scenario: str | None = None,
    vehicle: str | None = None,
    latency: Latency = None,
) -> None:
    """Convert a policy to a policy file, which executes no code when loaded, or to C.

    Loading a model (.zip) executes code that it contains: export only files that you trust.

    Args:
        model: A policy; for npz a file (.zip) saved by an algorithm with a feedforward network, such as PPO or SAC.
        to: npz, or c for microcontrollers, with the observer and golden vectors.
        out: File to write; the default has the name of the policy.
        scenario: Scenario for whose vehicle, interface, control period and latency C is written. The default is
            flight_breeze or windy, with the interface and the vehicle of the policy.
        vehicle: Vehicle in place of that of the scenario, a preset or TOML file.
        latency: Latency in place of that of the scenario, s: from the exposure to the moment when the command acts.
        vec_normalize: File (.pkl) saved by VecNormalize, if the model was trained with it. The default is the one with
            a usual name beside the model. Loading it executes code that it contains.
    """
    from quadpend_baselines.registry import gains_file
    from quadpend_train.policies.loading import load_policy, model_file

    gains = gains_file(model)
    name = f"{model.partition(':')[0]}:{gains.name}" if gains else Path(model).name
    stem = Path(model).with_suffix("") if Path(model).suffix in (".zip", ".npz") else Path(name)
    path = out or stem.with_suffix(".npz")
    if to == "c":
        path = out or stem.with_name(f"{re.sub('[^A-Za-z0-9]+', '_', stem.name)}.c")
    if path.exists():
        raise FileExistsError(f"{path} exists already: choose another file with --out")
    if to != "npz" and vec_normalize is not None:
        raise ValueError("--vec-normalize is for npz: export the model to npz first, and then the policy file")
    if to == "npz" and (given := [scenario, vehicle, latency]) != [None] * 3:
        names = [
            f"--{name}" for name, x in zip(("scenario", "vehicle", "latency"), given, strict=True) if x is not None
        ]
        raise ValueError(f"{', '.join(names)}: only C is written for a scenario; add --to c")
    files = [path]
    if to == "c":
        from quadpend_train.export.to_c import export_c, scenario_for

        policy = load_policy(model)
        chosen = named_scenarios([scenario or scenario_for(policy, stem.name)], vehicle, latency=latency)
        if len(chosen) != 1:
            raise ValueError(f"--scenario must be one scenario, not {len(chosen)}: {', '.join(chosen)}")
        ((name, flown),) = chosen.items()
        loop = f"{flown.vehicle.name}, {flown.interface} at {1.0 / flown.period:g} Hz"
        print(f"Scenario: {name} ({loop}, latency of {1e3 * flown.latency:g} ms)")
        files = export_c(policy, stem.name, flown, path)
    else:
        from quadpend_train.policies.from_sb3 import export_zip

        file = model_file(model)
        export_zip(file, vec_normalize, source=file.name).save(path)
    print("Written:", *files)
