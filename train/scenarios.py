"""Scenarios: which environment, in which wind, seen through which sensors, moved by which actuators.

Frozen data, so that a name means the same flight everywhere. A scenario of one's own is a TOML or JSON file with the
fields of `Scenario`, or such JSON on the command line:

    quadpend train --scenario '{"wind": "storm", "sensors": {"kind": "noise", "position": 0.002}}'
"""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode, VectorEnv

from quadpend_gym import Simulation
from quadpend_gym.actuators import as_actuators, check_chain
from quadpend_gym.randomization import as_ranges
from quadpend_gym.records import build, whole
from quadpend_gym.sensors import as_sensors
from quadpend_gym.wind import Constant, Sum, as_wind
from quadpend_gym.wrappers import (
    VectorActuatorWrapper,
    VectorHistoryWrapper,
    VectorOutputFeedbackWrapper,
    VectorParameterWrapper,
    VectorSensorWrapper,
)
from train.files import parse_mapping, read_mapping

ENVIRONMENTS = ("QuadPendulum-v0", "QuadPendulumHover-v0")


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

    def __post_init__(self) -> None:
        if self.env_id not in ENVIRONMENTS:
            raise ValueError(f"env_id must be one of {', '.join(ENVIRONMENTS)}, not {self.env_id!r}")
        if not isinstance(self.description, str):
            raise TypeError(f"description must be a text, not {self.description!r}")
        whole(self.history, "history", 1)
        whole(self.history_actions, "history_actions", 0)
        if not isinstance(self.output_feedback, bool):
            raise TypeError(f"output_feedback must be true or false, not {self.output_feedback!r}")
        object.__setattr__(self, "wind", Sum(as_wind(self.wind)))
        object.__setattr__(self, "sensors", as_sensors(self.sensors))
        object.__setattr__(self, "actuators", as_actuators(self.actuators))
        if self.parameters is not None:
            object.__setattr__(self, "parameters", as_ranges(self.parameters))
        object.__setattr__(self, "simulation", build(Simulation, self.simulation, "simulation"))
        check_chain(self.actuators, self.simulation)

    def make_vec(self, num_envs: int, autoreset_mode: AutoresetMode) -> VectorEnv[Any, Any, Any]:
        """The scenario as a vector environment."""
        env: VectorEnv[Any, Any, Any] = gym.make_vec(
            f"quadpend_gym:{self.env_id}",
            num_envs=num_envs,
            simulation=self.simulation,
            wind=self.wind,
            autoreset_mode=autoreset_mode,
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


HOVER = "QuadPendulumHover-v0"
SCENARIOS = {
    "calm": Scenario("no wind"),
    "breeze": Scenario("fluctuating force, 0.15 N on each axis of the quadrotor", "breeze"),
    "windy": Scenario("fluctuating force, 0.3 N on each axis of the quadrotor", "windy"),
    "storm": Scenario("moderate Dryden turbulence from any side, and gusts of 6 m/s on top", "storm"),
    "steady": Scenario("0.3 N along x on the quadrotor", Constant((0.3, 0.0, 0.0))),
    "gusts": Scenario("the paper's random gusts, setting in after 2 s", "paper"),
    "hover": Scenario("hover in calm air", env_id=HOVER),
    "hover_windy": Scenario("hover in a fluctuating 0.3 N", "windy", HOVER),
}


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
    if name.lstrip().startswith("{"):
        return build(Scenario, parse_mapping(name, "the scenario"), "scenario")
    path = Path(name)
    if path.suffix not in (".toml", ".json") or not path.is_file():
        raise ValueError(
            f"there is no scenario {name!r}; the scenarios are {', '.join(SCENARIOS)}; or give the path of a TOML or"
            " JSON file with one, or JSON"
        )
    return build(Scenario, read_mapping(path), str(path))


def resolve(name: str) -> str:
    """`name` if it is one of `SCENARIOS`, else the scenario itself as JSON, which needs no file."""
    return name if name in SCENARIOS else json.dumps(asdict(find_scenario(name)))
