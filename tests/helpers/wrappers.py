"""Parts of environments and stacks of wrappers as data, for single and for vector environments."""

from typing import Any

import gymnasium as gym
from gymnasium.vector import SyncVectorEnv, VectorEnv

from quadpend_gym import Dryden, Limits, Task, wrappers
from quadpend_gym.actuators import ActionDelay, MotorLag, PacketLoss, RateLimit
from quadpend_gym.core.arrays import Floats32
from quadpend_gym.randomization import Around
from quadpend_gym.sensors import Delay, Dropout, Noise, SampleHold
from tests.helpers.envs import AUTORESET_MODES, draw_actions, make, make_vec

Layers = list[tuple[Any, ...]]  # name and value of a part, or name and arguments of a wrapper, the innermost first

NOISE = Noise(
    position={"white": 0.002, "bias": 0.01, "walk": 0.01, "quantum": 0.001},
    velocity=0.01,
    euler=0.005,
    euler_rate={"white": 0.01, "bias": 0.02},
    direction={"white": 0.005, "walk": 0.01},
    direction_rate=0.02,
)
RANGES = Around(0.2)
WIND = ("wind", "storm")
TURBULENCE = ("wind", Dryden("moderate"))
SENSORS = ("sensors", [NOISE, Dropout(0.2), SampleHold(0.02), Delay(2)])
ACTUATORS = ("actuators", [PacketLoss(0.2), ActionDelay(2), RateLimit(50.0), MotorLag(0.03)])
PARAMETERS = ("parameters", RANGES)
OUTPUTS = ("observation", "output_feedback")
HISTORY = ("HistoryWrapper", 3, 2)

STACKS: dict[str, Layers] = {
    "wind": [WIND],
    "sensors": [SENSORS],
    "actuators": [ACTUATORS],
    "parameters": [PARAMETERS],
    "outputs": [OUTPUTS],
    "history": [HISTORY],
    "outputs, history": [OUTPUTS, HISTORY],
    "all": [TURBULENCE, PARAMETERS, ACTUATORS, SENSORS, OUTPUTS, HISTORY],
    "a wrapper twice": [
        ("actuators", [MotorLag(), {"kind": "action_delay"}]),
        ("sensors", [Delay(), {"kind": "noise", "position": 0.01}]),
        TURBULENCE,
        ("HistoryWrapper", 1, 1),
        PARAMETERS,
        ("HistoryWrapper", 2),
    ],
}
# Limits with which some episodes terminate, others are truncated, and every sub-environment has several episodes.
SHORT: dict[str, Any] = {
    "task": Task(limits=Limits(body_angle=0.5, pendulum_angle=0.25, tracking_error=0.13)),
    "max_episode_steps": 20,
}


def _parts(layers: Layers) -> dict[str, Any]:
    return {name: arguments[0] for name, *arguments in layers if not name.endswith("Wrapper")}


def _wrapped(env: Any, layers: Layers) -> Any:
    prefix = "Vector" if isinstance(env, VectorEnv) else ""
    for name, *arguments in layers:
        if name.endswith("Wrapper"):
            env = getattr(wrappers, prefix + name)(env, *arguments)
    return env


def make_wrapped(layers: Layers, **kwargs: Any) -> gym.Env[Any, Any]:
    """Return a single environment with parts, inside wrappers."""
    env: gym.Env[Any, Any] = _wrapped(make(**_parts(layers), **kwargs), layers)
    return env


def make_wrapped_vec(rows: int, layers: Layers, **kwargs: Any) -> VectorEnv[Any, Any, Any]:
    """Return the native vector environment with parts, inside wrappers."""
    env: VectorEnv[Any, Any, Any] = _wrapped(make_vec(rows, **_parts(layers), **kwargs), layers)
    return env


def make_sync_vec(rows: int, layers: Layers, mode: str, **kwargs: Any) -> VectorEnv[Any, Any, Any]:
    """Return Gymnasium's vector of wrapped single environments, the expected result for the wrapped vector env."""
    assert mode in AUTORESET_MODES
    return SyncVectorEnv([lambda: make_wrapped(layers, **kwargs)] * rows, autoreset_mode=mode)


def biased_actions(steps: int, rows: int) -> Floats32:
    """Return actions with a different bias for each sub-environment, so that episodes end at different times.

    Shape (steps, rows, 4).
    """
    return 0.3 * draw_actions(0, steps, rows) + 0.7 * draw_actions(1, rows)
