"""The command `list`: the names that the other commands take, with a line about each of them."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Literal

import tyro

from quadpend_baselines.gains import DESCRIPTIONS
from quadpend_gym import actuators, sensors, wind
from quadpend_gym.scenarios import SCENARIOS, SETS, Scenario
from quadpend_gym.tasks.task import ENVIRONMENTS, TASKS
from quadpend_gym.vehicles import POLES, VEHICLES, Pole, Vehicle
from quadpend_gym.vehicles.vehicle import as_vehicle
from quadpend_train.common.vehicle_toml import vehicle_toml
from quadpend_train.policies.loading import shipped_policies
from quadpend_train.policies.mlp_policy import MlpPolicy
from quadpend_train.training.settings import presets

Table = Literal["policies", "scenarios", "settings", "tasks", "vehicles", "poles", "winds", "sensors", "actuators"]
Rows = dict[str, str]  # descriptions by name


def list_names(tables: tyro.conf.Positional[tuple[Table, ...]] = (), vehicle: str | None = None) -> None:
    """List policies, scenarios, settings, tasks, vehicles, and models of wind and sensors.

    Args:
        tables: Tables to print; the default is all of them.
        vehicle: Vehicle to print as a TOML file, from which to begin one of your own, in place of tables.
    """
    if vehicle is not None:
        print(vehicle_toml(as_vehicle(vehicle), {}), end="")
        return
    for table in tables or TABLES:
        rows = TABLES[table]()
        width = max(map(len, rows))
        print(f"{table}:")
        for name, description in rows.items():
            print(f"  {name:<{width}}  {description}")
        print()


def _policies() -> Rows:
    return {**DESCRIPTIONS, **{name: _learned(name) for name in shipped_policies()}}


def _learned(name: str) -> str:
    card = MlpPolicy.load(name).card
    hybrid = card["hybrid"]
    base = f", {hybrid['kind']} of {hybrid['base_controller']}" if hybrid else ""
    if "script" in card:
        return (
            f"{card['script']['file']}{base}: {card['steps']:,} steps in {len(card['script']['scenarios'])} scenarios"
        )
    survival, rmse, algo = card["score"]["survival"], card["score"]["penalised_rmse"], card["settings"]["algo"].upper()
    return f"{algo}{base}: survival {survival:.1%}, penalised RMSE {1e3 * rmse:.1f} mm in training scenarios"


def _scenarios() -> Rows:
    sets = {name: f"set of {', '.join(members)}" for name, members in SETS.items()}
    return sets | {name: scenario.description for name, scenario in SCENARIOS.items()}


def _tasks() -> Rows:
    return dict.fromkeys(TASKS, "") | {task: f"the task of {env_id}" for env_id, task in ENVIRONMENTS.items()}


def _winds() -> Rows:
    """The presets, with the descriptions of the scenarios that have only this wind, and the kinds."""
    described = {scenario: scenario.description for scenario in SCENARIOS.values()}
    return {name: f"preset: {described.get(Scenario(wind=name), '')}" for name in wind.PRESETS} | _kinds(wind.KINDS)


def _kinds(kinds: Mapping[str, type[Any]]) -> Rows:
    return {name: (inspect.getdoc(kind) or "").splitlines()[0] for name, kind in kinds.items() if name != "sum"}


def _vehicle(vehicle: Vehicle) -> str:
    pole = next(name for name, known in POLES.items() if known == vehicle.pole)
    model = "the paper's attitude model" if vehicle.rotors is None else "four rotors"
    return f"{1e3 * vehicle.mass:g} g, pole {pole}, {model}"


def _pole(pole: Pole) -> str:
    return f"{1e3 * pole.mass:g} g, {pole.length:g} m from the pivot to the centre of mass"


TABLES: dict[str, Callable[[], Rows]] = {
    "policies": _policies,
    "scenarios": _scenarios,
    "settings": presets,
    "tasks": _tasks,
    "vehicles": lambda: {name: _vehicle(vehicle) for name, vehicle in VEHICLES.items()},
    "poles": lambda: {name: _pole(pole) for name, pole in POLES.items()},
    "winds": _winds,
    "sensors": lambda: _kinds(sensors.KINDS),
    "actuators": lambda: _kinds(actuators.KINDS),
}
