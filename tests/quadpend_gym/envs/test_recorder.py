"""The recorder: snapshots equal the true values of the running episode, and every state can be rendered."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym.envs.recorder import HISTORY_STEPS
from tests.helpers.envs import (
    AUTORESET_MODES,
    ENDLESS,
    WINDY,
    draw_actions,
    make,
    make_unwrapped,
    make_vec,
    run_actions,
)


def snapshots(env: Any) -> list[Any]:
    """Return the snapshots of all sub-environments."""
    return [env.unwrapped.recorder.snapshot(row) for row in range(env.unwrapped.world.num_envs)]


def test_snapshot_agrees_with_the_info() -> None:
    env = make_unwrapped(wind=WINDY, render_mode="rgb_array")
    env.reset(seed=2)
    steps = run_actions(env, draw_actions(2, 12))
    (snapshot,), info = snapshots(env), steps[-1][4]
    assert_allclose(snapshot.time, 0.12)
    assert_array_equal(snapshot.state.array, env.state.array)
    assert_array_equal(snapshot.disturbance, info["disturbance"])
    assert_allclose(snapshot.error, np.linalg.norm(info["tracking_error"]))
    assert_allclose(snapshot.tilt, info["tilt"])
    assert_allclose(snapshot.episode_return, sum(reward for _, reward, *_ in steps))
    assert_array_equal(snapshot.reference.as_array(), env.world.reference[0])


def bob(snapshot: Any) -> Any:
    """Return the position of the bob in a picture."""
    return snapshot.state.position + snapshot.rod_length * snapshot.state.direction


def test_trail_is_the_path_of_the_bob_in_the_last_200_steps_of_the_episode() -> None:
    env = make_unwrapped(task=ENDLESS, render_mode="rgb_array")
    for seed, steps in ((0, 30), (1, HISTORY_STEPS + 50)):
        env.reset(seed=seed)
        path = [bob(snapshots(env)[0])]
        for action in 0.1 * draw_actions(seed, steps):
            env.step(action)
            path.append(bob(snapshots(env)[0]))
        assert_array_equal(snapshots(env)[0].trail, path[-HISTORY_STEPS:])


@pytest.mark.parametrize("mode", AUTORESET_MODES[:2])
def test_snapshot_after_an_autoreset_shows_the_new_episode(mode: str) -> None:
    env = make_vec(3, render_mode="rgb_array", max_episode_steps=5, autoreset_mode=mode)
    env.reset(seed=0)
    run_actions(env, draw_actions(0, 5 if mode == "SameStep" else 6, 3))
    for snapshot in snapshots(env):
        assert (snapshot.time, snapshot.episode_return, len(snapshot.trail)) == (0.0, 0.0, 1)


def test_a_sub_environment_is_rendered_like_the_single_environment() -> None:
    env, rows = make(wind=WINDY, render_mode="rgb_array"), make_vec(4, wind=WINDY, render_mode="rgb_array")
    env.reset(seed=12)
    rows.reset(seed=10)
    actions = draw_actions(0, 8, 4)
    run_actions(env, actions[:, 2])
    run_actions(rows, actions)
    assert_array_equal(rows.render()[2], env.render())
