"""What a film keeps of an environment: what is true, of this episode, and enough for a picture of every state."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pygame
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quadpend_gym import Reference
from quadpend_gym.envs.recorder import HISTORY_STEPS
from quadpend_gym.viewer import scene
from quadpend_gym.wrappers import WindWrapper
from tests.helpers.envs import (
    AT_REST,
    AUTORESET_MODES,
    ENDLESS,
    WINDY,
    assert_same,
    draw_actions,
    make,
    make_unwrapped,
    make_vec,
    run_actions,
)
from tests.helpers.viewer import assert_picture
from tests.helpers.wrappers import make_wrapped


def shown(**kwargs: Any) -> Any:
    """A single environment with pictures, after its first reset."""
    env = make(render_mode="rgb_array", **kwargs)
    env.reset(seed=0)
    return env


def snapshots(env: Any) -> list[Any]:
    """What is to be seen of every row."""
    return [env.unwrapped.recorder.snapshot(row) for row in range(env.unwrapped.world.num_envs)]


def test_a_snapshot_tells_what_the_info_tells() -> None:
    env = make_unwrapped(wind=WINDY, render_mode="rgb_array")
    env.reset(seed=2)
    flight = run_actions(env, draw_actions(2, 12))
    (seen,), info = snapshots(env), flight[-1][4]
    assert_allclose(seen.time, 0.12)
    assert_array_equal(seen.state.array, env.state.array)
    assert_array_equal(seen.disturbance, info["disturbance"])
    assert_allclose(seen.error, np.linalg.norm(info["tracking_error"]))
    assert_allclose(seen.tilt, info["tilt"])
    assert_allclose(seen.episode_return, sum(reward for _, reward, *_ in flight))
    assert_array_equal(seen.reference.as_array(), env.world.reference[0])


def test_the_trail_is_the_bob_s_way_in_the_last_two_seconds_of_the_episode() -> None:
    env = make_unwrapped(task=ENDLESS, render_mode="rgb_array")
    for seed, steps in ((0, 30), (1, HISTORY_STEPS + 50)):
        env.reset(seed=seed)
        way = [snapshots(env)[0].bob]
        for action in 0.1 * draw_actions(seed, steps):
            env.step(action)
            way.append(snapshots(env)[0].bob)
        assert_array_equal(snapshots(env)[0].trail, way[-HISTORY_STEPS:])


def test_behind_actuators_and_with_drawn_parameters_what_is_true_is_shown() -> None:
    layers = [("ParameterWrapper", {"rod_length": (0.5, 0.6)}), ("ActuatorWrapper", {"kind": "motor_lag"})]
    env = make_wrapped(layers, render_mode="rgb_array")
    env.reset(seed=0)
    info = env.step(np.array([0.5, 0.1, 0.0, 0.0], np.float32))[4]
    (seen,), world = snapshots(env), env.unwrapped.world  # type: ignore[attr-defined]
    assert 0.5 <= seen.rod_length <= 0.6
    assert_allclose(np.linalg.norm(seen.bob - seen.state.position), seen.rod_length)
    assert_allclose(seen.thrust * world.simulation.command_scale[0], info["command"][0])
    assert 1.0 < seen.thrust < 1.2


@pytest.mark.parametrize("mode", AUTORESET_MODES[:2])
def test_a_row_that_was_reset_shows_its_new_episode(mode: str) -> None:
    env = make_vec(3, render_mode="rgb_array", max_episode_steps=5, autoreset_mode=mode)
    env.reset(seed=0)
    run_actions(env, draw_actions(0, 5 if mode == "SameStep" else 6, 3))
    for seen in snapshots(env):
        assert (seen.time, seen.episode_return, len(seen.trail)) == (0.0, 0.0, 1)
        assert_array_equal(seen.focus, seen.state.position)
        assert not seen.streak_offset.any()


def test_a_row_is_seen_as_the_single_environment_is() -> None:
    env, rows = make(wind=WINDY, render_mode="rgb_array"), make_vec(4, wind=WINDY, render_mode="rgb_array")
    env.reset(seed=12)
    rows.reset(seed=10)
    actions = draw_actions(0, 8, 4)
    run_actions(env, actions[:, 2])
    run_actions(rows, actions)
    assert_array_equal(rows.render()[2], env.render())


def test_the_picture_depends_on_the_episode_alone() -> None:
    """Not on earlier ones, and not on how often it was looked at."""
    pictures = []
    for before, looks in ((0, False), (0, True), (7, False)):
        env = make(wind=WINDY, render_mode="rgb_array")
        env.reset(seed=9)
        run_actions(env, draw_actions(1, before))
        env.reset(seed=4)
        for action in draw_actions(4, 10):
            env.step(action)
            if looks:
                env.render()
        pictures.append(env.render())
    assert_array_equal(pictures[1], pictures[0])
    assert_array_equal(pictures[2], pictures[0])


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_copy_of_what_was_looked_at_continues_identically(clone: Callable[[Any], Any]) -> None:
    env = shown()
    env.render()
    twin = clone(env)
    assert_same(run_actions(twin, draw_actions(0, 5)), run_actions(env, draw_actions(0, 5)))
    assert_array_equal(twin.render(), env.render())


def test_pictures_go_on_after_somebody_else_has_quit_pygame() -> None:
    env = shown()
    env.render()
    pygame.quit()
    env.step(np.zeros(4))
    assert_picture(env.render())


def test_wind_added_later_leaves_the_last_picture_until_the_next_reset() -> None:
    env = shown()
    env.step(np.zeros(4))
    last = env.render()
    windy = WindWrapper(env, "windy")
    assert_array_equal(windy.render(), last)
    windy.reset(seed=0)
    run_actions(windy, np.zeros((3, 4)))
    assert_picture(windy.render())


EXTREMES: dict[str, dict[str, Any]] = {
    "far away": {"state": {"position": (1e5, -1e5, 2.0)}},
    "high up": {"state": {"position": (0.0, 0.0, 1e5)}},
    "deep down": {"state": {"position": (0.0, 0.0, -1e5)}},
    "on the ground": {"state": {**AT_REST, "position": (0.0, 0.0, 0.0)}},
    "hanging": {"state": {"direction": (0.0, 0.0, -1.0)}},
    "level": {"state": {"direction": (1.0, 0.0, 0.0)}},
    "upside down": {"state": {"euler": (3.1, 0.0, 0.0)}},
    "pitched up": {"state": {"euler": (0.0, np.pi / 2, 0.0)}},
    "fast": {"state": {"velocity": (9e5, 9e5, 9e5)}},
    "whirling": {"state": {"direction_rate": (9e5, 0.0, 0.0)}},
    "a huge reference": {"reference": Reference(amplitude=(1000.0,) * 4, frequency=(1000.0,) * 4)},
}


@pytest.mark.parametrize("options", EXTREMES.values(), ids=EXTREMES.keys())
def test_there_is_a_picture_of_every_state(options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[Any] = []
    draw = scene.line
    monkeypatch.setattr(scene, "line", lambda *arguments: (lines.append(1), draw(*arguments)))
    env = make_unwrapped(task=ENDLESS, wind=WINDY, render_mode="rgb_array")
    env.reset(seed=0, options=options)
    assert_picture(env.render())
    env.step(np.ones(4))
    assert_picture(env.render())
    assert len(lines) < 2000, "it takes for ever"


def test_there_is_a_picture_of_every_task() -> None:
    assert_picture(shown(task={"references": {"height": [2000.0, 2000.0], "yaw_frequency": 5000.0}}).render())
