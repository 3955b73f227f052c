"""Episode ends: each limit alone, divergence, and the time limit."""

from typing import Any

import numpy as np
import pytest

from quadpend_gym import Constant, Limits, Reference, Task
from tests.helpers.envs import AT_REST, ENDLESS, make, make_unwrapped, make_vec, run_actions

HANGING = {"direction": (0.0, 0.0, -1.0)}


def lean(degrees: float) -> dict[str, Any]:
    """Return a start in which the pendulum leans by an angle towards −y."""
    return {"direction": (0.0, -np.sin(np.radians(degrees)), np.cos(np.radians(degrees)))}


def tilt(roll: float, pitch: float) -> dict[str, Any]:
    """Return a start in which the body has a roll and a pitch, in degrees."""
    return {"euler": (*np.radians((roll, pitch)), 0.0)}


def at(x: float, y: float, z: float) -> dict[str, Any]:
    """Return a start with the quadrotor at a position, m."""
    return {"position": (x, y, z)}


def ends(start: dict[str, Any], task: Task | str = "track") -> bool:
    """Return whether one step from hover, changed by `start`, terminates the episode."""
    env = make_unwrapped(task=task)
    env.reset(seed=0, options={"state": {**AT_REST, **start}, "reference": Reference.hover()})
    _, _, terminated, truncated, _ = env.step(np.zeros(4))
    assert not truncated
    return terminated


@pytest.mark.parametrize(
    ("inside", "past"),
    [
        pytest.param(lean(59.5), lean(60.5), id="pendulum past 60 degrees"),
        pytest.param(tilt(79.5, 0.0), tilt(80.5, 0.0), id="roll past 80 degrees"),
        pytest.param(tilt(0.0, -79.5), tilt(0.0, -80.5), id="pitch past 80 degrees"),
        pytest.param(tilt(60.0, 69.0), tilt(60.0, 71.0), id="roll and pitch past 80 degrees together"),
        pytest.param(at(2.99, 0.0, 2.0), at(3.01, 0.0, 2.0), id="error past 3 m in x"),
        pytest.param(at(0.0, -2.99, 2.0), at(0.0, -3.01, 2.0), id="error past 3 m in y"),
        pytest.param(at(0.0, 0.0, 4.99), at(0.0, 0.0, 5.01), id="error past 3 m in z"),
        pytest.param(at(2.0, 2.0, 2.9), at(2.0, 2.0, 3.1), id="error past 3 m altogether"),
        pytest.param(at(0.0, 0.0, 0.01), at(0.0, 0.0, -0.01), id="quadrotor on the ground"),
    ],
)
def test_each_limit_terminates_the_episode(inside: dict[str, Any], past: dict[str, Any]) -> None:
    assert not ends(inside)
    assert ends(past)


def test_bob_on_the_ground_terminates_the_episode() -> None:
    task = Task(limits=Limits(pendulum_angle=np.pi))
    assert not ends({**HANGING, **at(0.0, 0.0, 0.31)}, task)
    assert ends({**HANGING, **at(0.0, 0.0, 0.29)}, task)


def test_no_state_terminates_an_episode_without_limits() -> None:
    for start in (lean(180.0), tilt(180.0, 0.0), tilt(0.0, 90.0), at(100.0, 0.0, 0.0), at(0.0, 0.0, -100.0)):
        assert not ends(start, ENDLESS)


@pytest.mark.parametrize("wind", [{"force": 1e12}, {"bob_force": 1e12}, {"torque": 1e12}, {"velocity": 1e4}])
def test_divergence_terminates_and_the_observation_stays_finite(wind: dict[str, float]) -> None:
    env = make_unwrapped(task=ENDLESS, wind=Constant(**wind))
    env.reset(seed=0)
    for observation, reward, terminated, _, _ in run_actions(env, np.zeros((3, 4))):
        assert terminated
        assert env.observation_space.contains(observation)
        assert 0.0 <= reward <= 1.0
        assert np.isfinite(env.state.array).all()


def endings(env: Any, steps: int) -> list[tuple[bool, bool]]:
    """Return (terminated, truncated) of the first sub-environment at each step with zero actions."""
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape)
    return [tuple(bool(np.ravel(flag)[0]) for flag in env.step(action)[2:4]) for _ in range(steps)]  # type: ignore[misc]


both = pytest.mark.parametrize("env", [make, lambda **kwargs: make_vec(2, **kwargs)], ids=["single", "vector"])


@both
def test_termination_does_not_set_truncated_and_one_step_can_set_both(env: Any) -> None:
    flags = endings(env(), 200)
    steps = flags.index((True, False)) + 1
    assert flags[: steps - 1] == [(False, False)] * (steps - 1)
    assert endings(env(max_episode_steps=steps), steps)[-1] == (True, True)


@both
@pytest.mark.parametrize("settings", [{}, {"period": 0.005, "duration": 2.0}, {"period": 0.04, "duration": 2.0}])
def test_an_episode_of_10_s_or_of_its_seconds_is_truncated_at_any_control_period(env: Any, settings: Any) -> None:
    steps = round(settings.get("duration", 10.0) / settings.get("period", 0.01))
    assert endings(env(task=ENDLESS, **settings), steps) == [(False, False)] * (steps - 1) + [(False, True)]
