"""Stacks of wrappers as data, for a single environment and for a vector of them alike."""

from typing import Any

import gymnasium as gym
from gymnasium.vector import SyncVectorEnv, VectorEnv

from quadpend_gym import Dryden, Limits, Task, wrappers
from quadpend_gym.actuators import ActionDelay, MotorLag, RateLimit, RotorFault, Rotors
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import Delay, Dropout, Noise
from tests.helpers.envs import AUTORESET_MODES, draw_actions, make, make_vec

Layers = list[tuple[Any, ...]]  # from the inside out: the name of a wrapper, then its arguments

NOISE = Noise(
    position={"white": 0.002, "bias": 0.01, "walk": 0.01, "quantum": 0.001},
    velocity=0.01,
    euler=0.005,
    euler_rate={"white": 0.01, "bias": 0.02},
    direction={"white": 0.005, "walk": 0.01},
    direction_rate=0.02,
)
RANGES = Around(0.2)
WIND = ("WindWrapper", "storm")
TURBULENCE = ("WindWrapper", Dryden("moderate"))
SENSORS = ("SensorWrapper", [NOISE, Dropout(0.2), Delay(2)])
ACTUATORS = (
    "ActuatorWrapper",
    [ActionDelay(2), RateLimit(50.0), MotorLag(0.03), RotorFault(3, 0.8, 0.05), Rotors(1.2)],
)
PARAMETERS = ("ParameterWrapper", RANGES)
OUTPUTS = ("OutputFeedbackWrapper",)
HISTORY = ("HistoryWrapper", 3, 2)

STACKS: dict[str, Layers] = {
    "wind": [WIND],
    "sensors": [SENSORS],
    "actuators": [ACTUATORS],
    "parameters": [PARAMETERS],
    "outputs": [OUTPUTS],
    "history": [HISTORY],
    "outputs, history": [OUTPUTS, HISTORY],
    "all, the world inside": [TURBULENCE, PARAMETERS, ACTUATORS, SENSORS, OUTPUTS, HISTORY],
    "all, the world outside": [OUTPUTS, HISTORY, SENSORS, WIND, ACTUATORS, PARAMETERS],
    "all, mixed and some twice": [
        ("ActuatorWrapper", [MotorLag(), Rotors()]),
        ("SensorWrapper", Delay()),
        TURBULENCE,
        ("HistoryWrapper", 1, 1),
        PARAMETERS,
        ("ActuatorWrapper", {"kind": "action_delay"}),
        ("SensorWrapper", {"kind": "noise", "position": 0.01}),
        ("WindWrapper", "breeze"),
        ("HistoryWrapper", 2),
    ],
}
# Some episodes are terminated, the others truncated, and every row has a few.
SHORT: dict[str, Any] = {
    "task": Task(limits=Limits(body_angle=0.5, pendulum_angle=0.25, tracking_error=0.13)),
    "max_episode_steps": 20,
}


def wrapped(env: Any, layers: Layers) -> Any:
    """`env`, an Env or a VectorEnv, in wrappers, the first of them innermost."""
    prefix = "Vector" if isinstance(env, VectorEnv) else ""
    for name, *arguments in layers:
        env = getattr(wrappers, prefix + name)(env, *arguments)
    return env


def make_wrapped(layers: Layers, **kwargs: Any) -> gym.Env[Any, Any]:
    """A single environment in wrappers."""
    return wrapped(make(**kwargs), layers)


def make_wrapped_vec(rows: int, layers: Layers, **kwargs: Any) -> VectorEnv[Any, Any, Any]:
    """The native vector environment in wrappers."""
    return wrapped(make_vec(rows, **kwargs), layers)


def make_sync_vec(rows: int, layers: Layers, mode: str, **kwargs: Any) -> VectorEnv[Any, Any, Any]:
    """What Gymnasium makes of wrapped single environments: the oracle of the wrapped vector environment."""
    assert mode in AUTORESET_MODES
    return SyncVectorEnv([lambda: make_wrapped(layers, **kwargs)] * rows, autoreset_mode=mode)


def biased_actions(steps: int, rows: int) -> Floats32:
    """Actions with a bias of each row's own, shape (steps, rows, 4): rows end at different times."""
    return 0.3 * draw_actions(0, steps, rows) + 0.7 * draw_actions(1, rows)
