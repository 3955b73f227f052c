"""What the tests of the environments share: makers, winds, actions, flights and exact comparison."""

from collections.abc import Iterable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.testing import assert_array_equal

from quadpend_gym import (
    Constant,
    Limits,
    OrnsteinUhlenbeck,
    PaperGusts,
    QuadPendulumEnv,
    QuadPendulumVectorEnv,
    Sinusoid,
    Task,
)
from quadpend_gym.core.arrays import Floats32

IDS = ("QuadPendulum-v0", "QuadPendulumHover-v0")
AUTORESET_MODES = ("NextStep", "SameStep", "Disabled")
# Every model at once, with gusts that set in before an episode can end.
WINDY = (
    OrnsteinUhlenbeck(force=0.5, bob_force=0.1, torque=(0.02, 0.02, 0.01))
    + Sinusoid(force=(0.2, 0.0, 0.1), frequency=3.0)
    + PaperGusts(force=0.4, onset=0.05, hold=0.1)
    + Constant(bob_force=(0.0, 0.1, 0.0))
)
NO_LIMITS = Limits(pendulum_angle=np.pi, body_angle=np.pi, tracking_error=1e9, ground=-1e9)
ENDLESS = Task(limits=NO_LIMITS)
# Standing still at the point that `Reference.hover()` names.
AT_REST = {
    "position": (0.0, 0.0, 2.0),
    "velocity": (0.0, 0.0, 0.0),
    "euler": (0.0, 0.0, 0.0),
    "euler_rate": (0.0, 0.0, 0.0),
    "direction": (0.0, 0.0, 1.0),
    "direction_rate": (0.0, 0.0, 0.0),
}


def make(**kwargs: Any) -> gym.Env[Any, Any]:
    """The tracking environment with Gymnasium's own wrappers around it."""
    return gym.make("QuadPendulum-v0", **kwargs)


def make_unwrapped(**kwargs: Any) -> QuadPendulumEnv:
    """The tracking environment without wrappers and time limit."""
    env = make(**kwargs).unwrapped
    assert isinstance(env, QuadPendulumEnv)
    return env


def make_vec(num_envs: int, **kwargs: Any) -> QuadPendulumVectorEnv:
    """The native vector environment of the tracking task."""
    env = gym.make_vec("QuadPendulum-v0", num_envs=num_envs, **kwargs)
    assert isinstance(env, QuadPendulumVectorEnv)
    return env


def draw_actions(seed: int, *shape: int) -> Floats32:
    """Actions for a flight: every component uniform in ±1, shape (*shape, 4)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (*shape, 4)).astype(np.float32)


def run_actions(env: Any, actions: Iterable[Any]) -> list[Any]:
    """Everything that `env`, an Env or a VectorEnv, returns while it takes one action after the other."""
    return [env.step(action) for action in actions]


def rewards(flight: list[Any]) -> Any:
    """The rewards of a flight, one after the other."""
    return np.array([reward for _, reward, *_ in flight])


def assert_same(one: Any, other: Any) -> None:
    """Exact equality, to the last bit, of nested tuples, lists, dicts, arrays and numbers."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, list | tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        assert len(one) == len(other)
        for first, second in zip(one, other, strict=True):
            assert_same(first, second)
    else:
        assert_array_equal(one, other)


def select_info(info: dict[str, Any], row: Any) -> dict[str, Any]:
    """Row `row` of a vector environment's info, as the single environment would give it."""
    return {
        key: select_info(value, row) if isinstance(value, dict) else value[row]
        for key, value in info.items()
        if not key.startswith("_") and info[f"_{key}"][row]
    }
