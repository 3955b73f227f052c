"""Scenarios: which environment, in which wind, seen through which sensors, moved by which actuators.

Frozen data, in `scenarios.toml`, so that a name means the same flight everywhere. Two sets of them have names too:
`training`, which learners and tuners may see, and `test`, which is held out. A scenario of one's own is a TOML or JSON
file with the fields of `Scenario`, or such JSON on the command line:

    quadpend train --scenario '{"wind": "storm", "sensors": {"kind": "noise", "position": 0.002}}'
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_gym import Simulation
from quadpend_gym.actuators import as_actuators, check_chain
from quadpend_gym.core.validation import check_int, from_plain
from quadpend_gym.randomization import as_ranges
from quadpend_gym.sensors import as_sensors
from quadpend_gym.tasks import TASKS, RewardWeights, as_task
from quadpend_gym.wind import Sum, as_wind
from quadpend_gym.wrappers import (
    VectorActuatorWrapper,
    VectorHistoryWrapper,
    VectorOutputFeedbackWrapper,
    VectorParameterWrapper,
    VectorSensorWrapper,
)
from quadpend_train.common.files import parse_mapping, read_mapping

FILE = Path(__file__).with_name("scenarios.toml")
HOVER = "QuadPendulumHover-v0"
ENVIRONMENTS = {"QuadPendulum-v0": "track", HOVER: "hover"}  # and their tasks


@dataclass(frozen=True)
class Scenario:
    """An environment and the world around it.

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is unknown or out of range.
    """

    description: str = ""
    wind: Any = None  # as the keyword of `gymnasium.make`
    env_id: str = "QuadPendulum-v0"
    sensors: Any = ()  # as `SensorWrapper` takes them
    actuators: Any = ()  # as `ActuatorWrapper` takes them
    parameters: Any = None  # as `ParameterWrapper` takes them
    simulation: Any = field(default_factory=Simulation)  # the nominal one, as the keyword of `gymnasium.make`
    output_feedback: bool = False  # no velocities, see `OutputFeedbackWrapper`
    history: int = 1  # observations side by side, see `HistoryWrapper`
    history_actions: int = 0  # actions beside them
    task: Any = None  # as the keyword of `gymnasium.make`; None: that of env_id

    def __post_init__(self) -> None:
        if self.env_id not in ENVIRONMENTS:
            raise ValueError(f"env_id must be one of {', '.join(ENVIRONMENTS)}, not {self.env_id!r}")
        if not isinstance(self.description, str):
            raise TypeError(f"description must be a text, not {self.description!r}")
        check_int(self.history, "history", 1)
        check_int(self.history_actions, "history_actions", 0)
        if not isinstance(self.output_feedback, bool):
            raise TypeError(f"output_feedback must be true or false, not {self.output_feedback!r}")
        object.__setattr__(self, "wind", Sum(as_wind(self.wind)))
        object.__setattr__(self, "sensors", as_sensors(self.sensors))
        object.__setattr__(self, "actuators", as_actuators(self.actuators))
        if self.parameters is not None:
            object.__setattr__(self, "parameters", as_ranges(self.parameters))
        object.__setattr__(self, "simulation", from_plain(Simulation, self.simulation, "simulation"))
        if self.task is not None:
            object.__setattr__(self, "task", as_task(self.task))
        check_chain(self.actuators, self.simulation)

    def with_reward(self, reward: RewardWeights) -> "Scenario":
        """The same scenario with other weights of the reward."""
        task = TASKS[ENVIRONMENTS[self.env_id]] if self.task is None else self.task
        return replace(self, task=replace(task, reward=reward))

    def make_vec(
        self, num_envs: int, autoreset_mode: AutoresetMode, max_episode_steps: int = 1000
    ) -> VectorEnv[Any, Any, Any]:
        """The scenario as a vector environment."""
        env: VectorEnv[Any, Any, Any] = gym.make_vec(
            f"quadpend_gym:{self.env_id}",
            num_envs=num_envs,
            simulation=self.simulation,
            wind=self.wind,
            autoreset_mode=autoreset_mode,
            max_episode_steps=max_episode_steps,
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


_DATA = read_mapping(FILE)
SCENARIOS = {name: from_plain(Scenario, fields, name) for name, fields in _DATA["scenarios"].items()}
SETS = {name: tuple(members) for name, members in _DATA["sets"].items()}


def find_scenario(name: str) -> Scenario:
    """The scenario that `name` stands for.

    Args:
        name: of one of `SCENARIOS`, the path of a TOML or JSON file, or JSON that begins with a brace.

    Raises:
        TypeError: a field is of the wrong type.
        ValueError: it is none of these, or a field is unknown or out of range.
    """
    if name in SCENARIOS:
        return SCENARIOS[name]
    if name in SETS:
        raise ValueError(f"{name!r} is a set of scenarios: choose one of {', '.join(SETS[name])}")
    if name.lstrip().startswith("{"):
        return from_plain(Scenario, parse_mapping(name, "the scenario"), "scenario")
    path = Path(name)
    if path.suffix not in (".toml", ".json") or not path.is_file():
        raise ValueError(
            f"there is no scenario {name!r}; the scenarios are {', '.join(SCENARIOS)}; or give the path of a TOML or"
            " JSON file with one, or JSON"
        )
    return from_plain(Scenario, read_mapping(path), str(path))


def expand(names: Sequence[str]) -> list[str]:
    """`names` with the scenarios of a set in the place of its name."""
    return [member for name in names for member in SETS.get(name, (name,))]


def resolve(name: str) -> str:
    """`name` if it is one of `SCENARIOS`, else the scenario itself as JSON, which needs no file."""
    return name if name in SCENARIOS else json.dumps(asdict(find_scenario(name)))


def scenario_hash(scenario: Scenario) -> str:
    """Twelve hexadecimal digits that change with anything that is flown; the description is not."""
    data = {name: value for name, value in asdict(scenario).items() if name != "description"}
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:12]


def file_hash() -> str:
    """The same of the file that defines all names, whole."""
    return hashlib.sha256(FILE.read_bytes()).hexdigest()[:12]
