"""Helpers for tests of environments: constructors, winds, actions, stepping and exact comparison."""

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
    Simulation,
    Sinusoid,
    Task,
)
from quadpend_gym.core.arrays import Floats32

IDS = ("QuadPendulum-v0", "QuadPendulumHover-v0")
AUTORESET_MODES = ("NextStep", "SameStep", "Disabled")
# Every wind model at once, with gusts that start before an episode can end.
WINDY = (
    OrnsteinUhlenbeck(force=0.5, bob_force=0.1, torque=(0.02, 0.02, 0.01))
    + Sinusoid(force=(0.2, 0.0, 0.1), frequency=3.0)
    + PaperGusts(force=0.4, onset=0.05, hold=0.1)
    + Constant(bob_force=(0.0, 0.1, 0.0))
)
NO_LIMITS = Limits(pendulum_angle=np.pi, body_angle=np.pi, tracking_error=1e9, ground=-1e9)
ENDLESS = Task(limits=NO_LIMITS)
# The state of rest that tracks `Reference.hover()` exactly.
AT_REST = {
    "position": (0.0, 0.0, 2.0),
    "velocity": (0.0, 0.0, 0.0),
    "euler": (0.0, 0.0, 0.0),
    "euler_rate": (0.0, 0.0, 0.0),
    "direction": (0.0, 0.0, 1.0),
    "direction_rate": (0.0, 0.0, 0.0),
}


def parts(simulation: Simulation) -> dict[str, Any]:
    """Return the fields of a simulation as arguments of an environment."""
    return {name: getattr(simulation, name) for name in ("vehicle", "interface", "period", "substeps", "latency")}


def make(simulation: Simulation | None = None, **kwargs: Any) -> gym.Env[Any, Any]:
    """Return the tracking environment with Gymnasium's own wrappers."""
    return gym.make("QuadPendulum-v0", **(parts(simulation) if simulation else {}), **kwargs)


def make_unwrapped(**kwargs: Any) -> QuadPendulumEnv:
    """Return the tracking environment without wrappers."""
    env = make(**kwargs).unwrapped
    assert isinstance(env, QuadPendulumEnv)
    return env


def make_vec(num_envs: int, simulation: Simulation | None = None, **kwargs: Any) -> QuadPendulumVectorEnv:
    """Return the native vector environment of the tracking task."""
    env = gym.make_vec("QuadPendulum-v0", num_envs, **(parts(simulation) if simulation else {}), **kwargs)
    assert isinstance(env, QuadPendulumVectorEnv)
    return env


def draw_actions(seed: int, *shape: int) -> Floats32:
    """Return random actions, every component uniform in ±1, shape (*shape, 4)."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (*shape, 4)).astype(np.float32)


def run_actions(env: Any, actions: Iterable[Any]) -> list[Any]:
    """Step `env`, an Env or a VectorEnv, with one action after the other, and return what each step returned."""
    return [env.step(action) for action in actions]


def rewards(steps: list[Any]) -> Any:
    """Return the rewards of the steps that `run_actions` returned."""
    return np.array([reward for _, reward, *_ in steps])


def assert_same(one: Any, other: Any) -> None:
    """Assert exact equality of nested tuples, lists, dicts, arrays and numbers."""
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
    """Return the info of one sub-environment in the form of the single environment's info."""
    return {
        key: select_info(value, row) if isinstance(value, dict) else value[row]
        for key, value in info.items()
        if not key.startswith("_") and info[f"_{key}"][row]
    }
