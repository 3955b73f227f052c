"""Environments that follow trajectories: observations, resets and storage."""

from typing import Any

import pytest
from numpy.testing import assert_allclose

from quadpend_gym import Reference, StartSettings, Task, Waypoints
from quadpend_gym.tasks.observation import read_observation
from tests.helpers.envs import draw_actions, make_unwrapped

WAYPOINTS = Waypoints((0, 2, 4, 6), ((0, 0, 2), (1, 0, 2, 0.3), (1, 1, 2.5), (0, 1, 2)))
SINUSOIDS = Reference(amplitude=(0.5, 0.4, 0.1, 0.2), frequency=(1.0, 2.0, 3.0, 1.0))
TOUR = Waypoints((0, 2, 4), ((0, 0, 2), (1, 0, 2, 0.3), (0, 1, 2)))
DATA = {"kind": "waypoints", "times": [0, 2, 4, 6], "points": [[0, 0, 2], [1, 0, 2, 0.3], [1, 1, 2.5], [0, 1, 2]]}
EXACT = StartSettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("trajectory", [WAYPOINTS, SINUSOIDS], ids=["waypoints", "sinusoids"])
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
    for options, expected in ((None, WAYPOINTS), ({"reference": SINUSOIDS}, SINUSOIDS), ({"reference": TOUR}, TOUR)):
        env.reset(seed=0, options=options)
        assert world.trajectory(0) == expected
    env.reset()
    assert world.trajectory(0) == WAYPOINTS
