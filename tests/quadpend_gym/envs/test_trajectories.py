"""Environments that follow trajectories: resets, sensors, copies, specifications, storage and pictures."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import QuadPendulumVectorEnv, Reference, Sinusoids, StartSettings, Task, Waypoints
from quadpend_gym.core.arrays import Floats
from quadpend_gym.sensors import Delay, Noise
from quadpend_gym.tasks.observation import read_observation
from quadpend_gym.tasks.trajectory_table import TrajectoryTable
from quadpend_gym.wrappers import SensorWrapper, VectorSensorWrapper
from tests.helpers.envs import assert_same, draw_actions, make, make_unwrapped, make_vec, run_actions

WAYPOINTS = Waypoints((0, 2, 4, 6), ((0, 0, 2), (1, 0, 2, 0.3), (1, 1, 2.5), (0, 1, 2)))
LAP = Waypoints((0, 2, 4), ((0.5, 0, 2), (-0.5, 0, 2), (0.5, 0, 2)), closed=True)
CHORD = Sinusoids(
    terms=[{"amplitude": (0.5, 0.4, 0.1, 0.2), "frequency": 1.0}, {"amplitude": 0.05, "frequency": (3, 2, 1, 0)}]  # type: ignore[arg-type]
)
HOVER = Reference.hover(1.0)
MIXED = (WAYPOINTS, HOVER, CHORD, LAP, WAYPOINTS)
DATA = {"kind": "waypoints", "times": [0, 2, 4, 6], "points": [[0, 0, 2], [1, 0, 2, 0.3], [1, 1, 2.5], [0, 1, 2]]}
EXACT = StartSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ACTIONS = 0.2 * draw_actions(1, 30, 5)


@pytest.fixture
def env() -> QuadPendulumVectorEnv:
    return make_vec(5, wind="windy")


@pytest.mark.parametrize("row", range(5))
@pytest.mark.parametrize("sensors", [[], [Noise(position=0.01), Delay(1)]], ids=["true states", "sensors"])
def test_every_row_of_a_mixture_equals_the_single_environment(row: int, sensors: list[Any]) -> None:
    many: Any = VectorSensorWrapper(make_vec(5, wind="windy"), sensors)
    one: Any = SensorWrapper(make_unwrapped(wind="windy"), sensors)
    observation = many.reset(seed=8, options={"reference": MIXED})[0]
    assert_array_equal(one.reset(seed=8 + row, options={"reference": MIXED[row]})[0], observation[row])
    for actions in ACTIONS:
        ours, theirs = many.step(actions), one.step(actions[row])
        for mine, other in zip(ours[:3], theirs[:3], strict=True):
            assert_array_equal(mine[row], other)


@pytest.mark.parametrize("trajectory", [WAYPOINTS, LAP, CHORD], ids=["waypoints", "closed", "sinusoids"])
def test_observation_and_start_are_those_of_the_trajectory(trajectory: Any) -> None:
    env = make_unwrapped(task=Task(trajectory=trajectory, start=EXACT))
    env.reset(seed=0)
    point = trajectory.derivatives(0.0)
    assert_allclose(env.state.position[2], point[0, 2], atol=1e-12)
    assert_allclose(env.state.euler[2], point[0, 3], atol=1e-12)
    for step, action in enumerate(0.1 * draw_actions(2, 5), 1):
        observation, _, _, _, info = env.step(action)
        wanted = trajectory.derivatives(0.01 * step)
        for order in range(2, 7):
            assert_allclose(
                read_observation(observation, f"reference_{order}"), wanted[order, :3], rtol=1e-6, atol=1e-6
            )
        assert_allclose(read_observation(observation, "yaw_reference"), wanted[:3, 3], rtol=1e-6, atol=1e-6)
        bob = env.state.position + 0.3 * env.state.direction * [1.0, 1.0, 0.0]
        assert_allclose(info["tracking_error"], bob - wanted[0, :3], atol=1e-12)


def test_the_option_replaces_the_trajectory_of_the_task_for_one_episode() -> None:
    env = make_unwrapped(task={"trajectory": DATA})
    world = env.world
    for options, expected in ((None, WAYPOINTS), ({"reference": CHORD}, CHORD), ({"reference": HOVER}, HOVER)):
        env.reset(seed=0, options=options)
        assert world.trajectory(0) == expected
    env.reset()
    assert world.trajectory(0) == WAYPOINTS


def test_a_trajectory_changes_neither_random_starts_nor_the_wind(env: QuadPendulumVectorEnv) -> None:
    env.reset(seed=0, options={"reference": Reference.hover()})
    state, wind = env.world.state.copy(), env.world.wind.copy()
    env.reset(seed=0, options={"reference": Waypoints((0, 5), ((0, 0, 2), (1, 0, 2)))})
    assert_array_equal(env.world.state, state)
    assert_array_equal(env.world.wind, wind)


@pytest.mark.parametrize("task", [Task(trajectory=CHORD), {"trajectory": DATA}, Task(trajectory=HOVER)])
def test_a_specification_with_a_trajectory_survives_json(task: Any) -> None:
    env = make(task=task)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert_same(again.reset(seed=3), env.reset(seed=3))
    assert_same(run_actions(again, ACTIONS[:, 0]), run_actions(env, ACTIONS[:, 0]))


def test_equal_trajectories_are_stored_once_and_old_ones_are_removed() -> None:
    table = TrajectoryTable(4096)
    table.assign(np.arange(4096), [CHORD])
    assert table.numbers.size == CHORD.packed.size
    table = TrajectoryTable(2)
    for length in range(1, 50):
        new = Waypoints((0, length), ((0, 0, 2), (1, 0, 2)))
        table.assign(np.array([0]), [new])
        table.assign(np.array([1]), [CHORD])
        assert table.find(0) == new
        assert table.find(1) == CHORD
        assert_array_equal(stored(table, 0, new), new.packed)
        assert_array_equal(stored(table, 1, CHORD), CHORD.packed)
        assert table.numbers.size == new.packed.size + CHORD.packed.size
    table.assign(np.arange(2), [None])
    assert not table.in_use


def stored(table: TrajectoryTable, row: int, trajectory: Any) -> Floats:
    """The numbers that the kernel reads for a row."""
    first = table.first[row]
    return table.numbers[first : first + trajectory.packed.size]
