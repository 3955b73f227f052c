"""Render modes: what `render` returns, also inside other wrappers, and that rendering changes no number."""

from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from tests.helpers.envs import (
    AUTORESET_MODES,
    WINDY,
    assert_same,
    draw_actions,
    make,
    make_unwrapped,
    make_vec,
    run_actions,
)
from tests.helpers.viewer import assert_picture
from tests.helpers.wrappers import SHORT, biased_actions


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def test_rgb_array_of_a_vector_env_is_one_array_for_each_sub_environment() -> None:
    env = make_vec(9, render_mode="rgb_array", autoreset_mode="SameStep", **SHORT)
    env.reset(seed=0)
    run_actions(env, biased_actions(30, 9))
    frames = env.render()
    assert isinstance(frames, tuple)
    assert len(frames) == 9
    for frame in frames:
        assert_picture(frame)


def test_a_sub_environment_is_rendered_like_the_single_environment() -> None:
    env, rows = make(wind=WINDY, render_mode="rgb_array"), make_vec(4, wind=WINDY, render_mode="rgb_array")
    env.reset(seed=12)
    rows.reset(seed=10)
    actions = draw_actions(0, 8, 4)
    run_actions(env, actions[:, 2])
    run_actions(rows, actions)
    assert np.array_equal(rows.render()[2], env.render())


@pytest.mark.parametrize("mode", AUTORESET_MODES[:2])
def test_a_picture_after_an_autoreset_shows_the_new_episode(mode: str) -> None:
    env = make_vec(3, render_mode="rgb_array", max_episode_steps=5, autoreset_mode=mode)
    env.reset(seed=0)
    run_actions(env, draw_actions(0, 5 if mode == "SameStep" else 6, 3))
    for row in range(3):
        snapshot = env.recorder.snapshot(row)  # type: ignore[union-attr]
        assert (snapshot.time, snapshot.episode_return, len(snapshot.trail)) == (0.0, 0.0, 1)


@pytest.mark.parametrize("mode", ["rgb_array", "human"])
def test_a_render_mode_changes_no_number(mode: str) -> None:
    one, other = make(wind=WINDY, render_mode=mode), make(wind=WINDY)
    for seed in (3, None):
        assert_same(one.reset(seed=seed), other.reset(seed=seed))
        for action in draw_actions(0, 6):
            assert_same(one.step(action), other.step(action))
            one.render()
    one.close()


def test_render_before_reset_raises_reset_needed() -> None:
    for env in (make(render_mode="rgb_array"), make_unwrapped(render_mode="rgb_array")):
        with pytest.raises(ResetNeeded, match="reset") as caught:
            env.render()
        assert "\n" not in str(caught.value)
    rows = make_vec(2, render_mode="rgb_array")
    rows.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded):
        rows.render()


@pytest.mark.parametrize("env", [make(), make_vec(2)], ids=["single", "vector"])
def test_without_a_render_mode_there_is_no_recorder_and_render_warns(env: Any) -> None:
    env.reset(seed=0)
    assert env.unwrapped.recorder is None
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None
