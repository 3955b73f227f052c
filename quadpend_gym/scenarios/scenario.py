"""Scenarios: an environment with its wind, sensors, actuators and parameters, as data.

The TOML files of this folder define the scenarios of this package, so that a name always means the same episodes:
`scenarios.toml` those of the paper's vehicle, `hummingbird.toml` those of a real one. They also name sets of scenarios:
`training` and `training-hummingbird`, for training and tuning, and sets that are held out, such as `test`. Users write
their own scenarios as TOML or JSON files with the fields of `Scenario`, or as JSON on the command line:

    quadpend train --scenarios '{"wind": "storm", "sensors": {"kind": "noise", "position": 0.002}}'

A scenario or a set with another vehicle or command interface has these in its name, such as ``"windy · crazyflie"`` and
``"windy · crazyflie · body_rates"``, see `Scenario.with_vehicle`.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_gym import Simulation
from quadpend_gym.actuators import as_actuators, check_chain
from quadpend_gym.core.factories import call_factory, find_factory, is_factory
from quadpend_gym.core.files import parse_mapping, read_mapping
from quadpend_gym.core.models import to_plain_data
from quadpend_gym.core.validation import check_int, check_positive, from_plain, suggest
from quadpend_gym.vehicles import INTERFACES
from quadpend_gym.randomization import as_ranges
from quadpend_gym.sensors import as_sensors, check_periods
from quadpend_gym.tasks import ENVIRONMENTS, TASKS, RewardWeights, Task, as_task
from quadpend_gym.tasks.feasibility import check_feasible
from quadpend_gym.vehicles import VEHICLES, as_vehicle
from quadpend_gym.wind import Rescaled, Sum, WindFromFactory, as_wind
from quadpend_gym.wrappers import (
    VectorActuatorWrapper,
    VectorHistoryWrapper,
    VectorOutputFeedbackWrapper,
    VectorParameterWrapper,
    VectorSensorWrapper,
)

SCENARIO_FILE = Path(__file__).with_name("scenarios.toml")
HOVER = "QuadPendulumHover-v0"
_MOST_STEPS = 1_000_000  # of an episode


@dataclass(frozen=True)
class Scenario:
    """An environment with its wind, sensors, actuators and parameters.

    Attributes:
        description: Description for tables; not part of the hash.
        wind: Wind, as the keyword of `gymnasium.make`.
        env_id: Id of the environment, a key of `ENVIRONMENTS`.
        sensors: Sensor models, as `SensorWrapper` takes them.
        actuators: Actuator models, as `ActuatorWrapper` takes them.
        parameters: Ranges of the physical parameters, as `ParameterWrapper` takes them; None: nominal parameters.
        simulation: Nominal simulation, as the keyword of `gymnasium.make`.
        output_feedback: Whether the observation has no velocities, see `OutputFeedbackWrapper`.
        history: Number of successive observations that are stacked into one, see `HistoryWrapper`.
        history_actions: Number of past actions that are appended to the observation.
        task: Task, as the keyword of `gymnasium.make`; None: the task of `env_id`.
        duration: Length of an episode, s; a whole number of control periods (`simulation.period`).
        loop_known: Whether controllers know the delays, lags and rate limits among `sensors` and `actuators`.

    Raises:
        TypeError: If a value has the wrong type.
        ValueError: If a value is unknown or out of range.
    """

    description: str = ""
    wind: Any = None
    env_id: str = "QuadPendulum-v0"
    sensors: Any = ()
    actuators: Any = ()
    parameters: Any = None
    simulation: Any = field(default_factory=Simulation)
    output_feedback: bool = False
    history: int = 1
    history_actions: int = 0
    task: Any = None
    duration: float = 10.0
    loop_known: bool = True

    def __post_init__(self) -> None:
        if self.env_id not in ENVIRONMENTS:
            raise ValueError(f"env_id must be one of {', '.join(ENVIRONMENTS)}, not {self.env_id!r}")
        if not isinstance(self.description, str):
            raise TypeError(f"description must be a string, not {self.description!r}")
        check_int(self.history, "history", 1)
        check_int(self.history_actions, "history_actions", 0)
        for name in ("output_feedback", "loop_known"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"{name} must be true or false, not {getattr(self, name)!r}")
        object.__setattr__(self, "wind", Sum(as_wind(self.wind)))
        object.__setattr__(self, "sensors", as_sensors(self.sensors))
        object.__setattr__(self, "actuators", as_actuators(self.actuators))
        if self.parameters is not None:
            object.__setattr__(self, "parameters", as_ranges(self.parameters))
        object.__setattr__(self, "simulation", from_plain(Simulation, self.simulation, "simulation"))
        if self.task is not None:
            object.__setattr__(self, "task", as_task(self.task))
            if self.task.trajectory is not None:
                check_feasible(self.task.trajectory, self.simulation, self.task.limits, self.task.side)
        check_chain(self.actuators, self.simulation)
        check_periods(self.sensors, self.simulation.period)
        object.__setattr__(self, "duration", check_positive(self.duration, "duration"))
        periods = self.duration / self.simulation.period
        if not 0.5 < periods < _MOST_STEPS + 0.5 or abs(round(periods) - periods) > 1e-9 * periods:
            raise ValueError(
                f"duration must be a whole number from 1 to {_MOST_STEPS} of control periods of"
                f" {self.simulation.period:g} s (simulation.period), not {self.duration:g} s"
            )

    @property
    def steps(self) -> int:
        """Number of control steps of an episode."""
        steps: int = round(self.duration / self.simulation.period)
        return steps

    @property
    def resolved_task(self) -> Task:
        """The task, that of `env_id` if `task` is None."""
        return TASKS[ENVIRONMENTS[self.env_id]] if self.task is None else self.task

    def with_reward(self, reward: RewardWeights) -> "Scenario":
        """Return the scenario with other reward weights."""
        return replace(self, task=replace(self.resolved_task, reward=reward))

    def with_vehicle(self, vehicle: Any = None, interface: str | None = None) -> "Scenario":
        """Return the scenario with another vehicle, another command interface, or both.

        Forces of the wind are multiplied by the ratio of the weights of the new and the old vehicle, and torques by
        that of their torque limits about each axis, so that they are as strong for the one as for the other. Wind
        velocities, starts, references, sensors and actuators do not change.

        Args:
            vehicle: Vehicle, as `quadpend_gym.vehicles.as_vehicle` takes it; None: that of the scenario.
            interface: What an action commands; None: as in the scenario.

        Raises:
            ValueError: If there is no such vehicle or interface, `vehicle` has the wrong type, or they do not fit the
                rest of the scenario.
        """
        old = self.simulation
        if vehicle is None:
            return self if interface is None else replace(self, simulation=replace(old, interface=interface))
        found = as_vehicle(vehicle)
        new = Simulation(
            period=old.period,
            substeps=old.substeps,
            vehicle=found,
            interface=old.interface if interface is None else interface,
            latency=old.latency,
        )
        scale = new.parameters.hover_thrust / old.parameters.hover_thrust
        roll_pitch, yaw = (new.torque_limits[i] / old.torque_limits[i] for i in range(2))
        torque_scale = (roll_pitch, roll_pitch, yaw)
        same = {scale, *torque_scale} == {1.0}
        wind = self.wind if same else [Rescaled(model, scale, torque_scale) for model in self.wind.models]
        note = f"; vehicle {found.name}, forces of the wind × {scale:.3g}"
        return replace(self, simulation=new, wind=wind, description=f"{self.description}{note}")

    def make_vec(
        self, num_envs: int, autoreset_mode: AutoresetMode, max_episode_steps: int | None = None
    ) -> VectorEnv[Any, Any, Any]:
        """Return a vector environment of the scenario.

        Args:
            num_envs: Number of sub-environments.
            autoreset_mode: Autoreset mode of the vector environment.
            max_episode_steps: Control steps after which an episode is truncated; None: `steps`.
        """
        env: VectorEnv[Any, Any, Any] = gym.make_vec(
            f"quadpend_gym:{self.env_id}",
            num_envs=num_envs,
            simulation=self.simulation,
            wind=self.wind,
            autoreset_mode=autoreset_mode,
            max_episode_steps=self.steps if max_episode_steps is None else max_episode_steps,
            **({} if self.task is None else {"task": self.task}),
        )
        if self.parameters is not None:
            env = VectorParameterWrapper(env, self.parameters)
        if self.actuators:
            env = VectorActuatorWrapper(env, self.actuators)
        if self.sensors:
            env = VectorSensorWrapper(env, self.sensors)
        if self.output_feedback:
            env = VectorOutputFeedbackWrapper(env)
        if self.history > 1 or self.history_actions:
            env = VectorHistoryWrapper(env, self.history, self.history_actions)
        return env


def _read_scenarios(path: Path) -> tuple[dict[str, Scenario], dict[str, tuple[str, ...]]]:
    """Return the scenarios and the sets of a file; the table `defaults` has fields of all scenarios of the file."""
    data = read_mapping(path)
    common = data.get("defaults", {})
    scenarios = {name: from_plain(Scenario, {**common, **own}, name) for name, own in data["scenarios"].items()}
    return scenarios, {name: tuple(members) for name, members in data["sets"].items()}


SCENARIOS, SETS = _read_scenarios(SCENARIO_FILE)
for _more in map(_read_scenarios, sorted(SCENARIO_FILE.parent.glob("*.toml"))):
    SCENARIOS |= _more[0]
    SETS |= _more[1]
HELD_OUT = tuple(name for name in SETS if not name.startswith("training"))  # sets for results only
_SEPARATOR = " · "


def with_changes(name: str, vehicle: str | None = None, interface: str | None = None) -> str:
    """Return the name of a scenario or a set with another vehicle or interface, such as "windy · crazyflie"."""
    return _SEPARATOR.join(part for part in (name, vehicle, interface) if part)


def split_changes(name: str) -> tuple[str, str | None, str | None]:
    """Return the scenario or the set in a name of `with_changes`, and its vehicle and interface, None if not given."""
    head, brace, tail = name.rpartition("}")  # JSON may contain the separator
    first, *changes = tail.split(_SEPARATOR)
    interface = changes.pop() if changes and changes[-1] in INTERFACES else None
    return head + brace + first, _SEPARATOR.join(changes) or None, interface


def find_scenario(name: str) -> Scenario:
    """Return a scenario by its name, from a file, from JSON, or from the user's own code.

    Args:
        name: Key of `SCENARIOS`, path of a TOML or JSON file, JSON that begins with a brace, or ``"module:factory"``: a
            function of the user's own code that returns a `Scenario`, or a wind model for the scenario without other
            changes. A vehicle and an interface may follow, see `with_changes`.

    Raises:
        TypeError: If a field has the wrong type.
        ValueError: If `name` is none of these, a field is unknown or out of range, or the factory fails.
    """
    name, vehicle, interface = split_changes(name)
    if vehicle or interface:
        return find_scenario(name).with_vehicle(vehicle, interface)
    if name in SCENARIOS:
        return SCENARIOS[name]
    if name in SETS:
        raise ValueError(f"{name!r} is a set of scenarios: choose one of {', '.join(SETS[name])}")
    if name.lstrip().startswith("{"):
        return from_plain(Scenario, parse_mapping(name, "the scenario"), "scenario")
    if is_factory(name):
        made = call_factory(name, find_factory(name))
        return made if isinstance(made, Scenario) else Scenario(wind=_checked_wind(name, made))
    path = Path(name)
    if path.suffix not in (".toml", ".json") or not path.is_file():
        raise ValueError(
            f"there is no file {name!r}"
            if path.suffix in (".toml", ".json")
            else f"there is no scenario {name!r}{suggest(name, [*SCENARIOS, *SETS])}; the scenarios are"
            f" {', '.join(SCENARIOS)}; or give the path of a TOML or JSON file, JSON, or 'module:factory'"
        )
    return from_plain(Scenario, read_mapping(path), str(path))


def _checked_wind(name: str, made: Any) -> WindFromFactory:
    """Return the wind of a factory as data, after checking that what the factory returned is a wind."""
    try:
        as_wind(made)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must return a Scenario or a wind model, not {made!r}") from error
    return WindFromFactory(name)


def as_scenario(value: Any) -> Scenario:
    """Convert `value` to a scenario.

    Args:
        value: A `Scenario`, a name as for `find_scenario`, a mapping of the fields of a scenario, or a wind model.

    Raises:
        TypeError: If `value` is none of these.
        ValueError: If a name or a field is unknown, or a value is out of range.
    """
    if isinstance(value, str):
        return find_scenario(value)
    if isinstance(value, Scenario | Mapping):
        return from_plain(Scenario, value, "scenario")
    try:
        return Scenario(wind=value)
    except TypeError as error:
        raise TypeError(
            f"a scenario must be a Scenario, its name, its fields or a wind model, not {value!r}"
        ) from error


def expand_sets(names: Sequence[str]) -> list[str]:
    """Return `names` with each name of a set, also with a vehicle, replaced by the names of its scenarios."""
    found = [split_changes(name) for name in names]
    return [with_changes(member, *changes) for name, *changes in found for member in SETS.get(name, (name,))]


def scenario_data(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a scenario as data for JSON.

    An object of the user's own class becomes its `repr` without its address in memory.
    """
    return {item.name: to_plain_data(getattr(scenario, item.name), _name) for item in fields(scenario)}


def _name(item: Any) -> str:
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(item))


def name_or_json(name: str) -> str:
    """Return the scenario as JSON, which does not depend on a file.

    A key of `SCENARIOS` and a text ``"module:factory"`` are returned as they are, also with a vehicle of the package.
    """
    found = find_scenario(name)
    base, vehicle, _ = split_changes(name)
    lasting = (base in SCENARIOS or is_factory(base)) and (vehicle is None or vehicle in VEHICLES)
    return name if lasting else json.dumps(scenario_data(found))


def names_without_files(name: str) -> list[str]:
    """Return a scenario as by `name_or_json`, or the name of a set; a set with a vehicle file becomes its scenarios."""
    base, vehicle, _ = split_changes(name)
    if base in SETS and (vehicle is None or vehicle in VEHICLES):
        return [name]
    return [name_or_json(member) for member in expand_sets([name])]


def scenario_hash(scenario: Scenario) -> str:
    """Return twelve hexadecimal digits of the hash of a scenario without its description.

    The hash covers objects of the user's own code only as `scenario_data` shows them.
    """
    data = {name: value for name, value in scenario_data(scenario).items() if name != "description"}
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:12]


def scenario_file_hash() -> str:
    """Return twelve hexadecimal digits of the hash of `scenarios.toml`, including comments.

    Results of other scenarios are known by their `scenario_hash`.
    """
    return hashlib.sha256(SCENARIO_FILE.read_bytes()).hexdigest()[:12]
