"""Wrong input raises an error of one sentence that names it, and leaves the environment unchanged."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.testing import assert_array_equal

from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import ENDLESS, WINDY, assert_same, draw_actions, make, make_unwrapped, make_vec, run_actions

NAN = np.nan
BAD_ACTIONS: dict[str, tuple[Any, str]] = {
    "nan": ((NAN, 0, 0, 0), "action must be .*nan"),
    "too large": ((0, 1.001, 0, 0), r"action .* \[-1, 1\], not .*1.00"),
    "short": ((0, 0, 0), r"action must be numbers of shape \(4,\), not \(0, 0, 0\)"),
    "text": ("hover", "action must be numbers of shape .* not 'hover'"),
}
BAD_OPTIONS: dict[str, tuple[Any, str]] = {
    "unknown option": ({"wind": None}, "no option 'wind'; there are state, reference"),
    "unknown field": ({"state": {"speed": (0, 0, 0)}}, "no field of the state 'speed'; there are position"),
    "short field": ({"state": {"position": (0, 0)}}, r"'position'.* shape \(3,\)"),
    "nan": ({"state": {"velocity": (0, NAN, 0)}}, "'velocity'.* numbers between .* nan"),
    "zero direction": ({"state": {"direction": (0, 0, 0)}}, "'direction'.* zero"),
    "bad after good": ({"state": {"position": (9, 9, 9), "euler": NAN}}, "'euler'"),
    "text": ({"state": {"position": "high"}}, "'position'.* not 'high'"),
    "not a mapping": ({"state": np.zeros(18)}, "'state'.* must be a mapping"),
    "reference": ({"reference": "circle"}, "reference must be a Reference, Waypoints or a mapping"),
    "unknown parameter": ({"parameters": {"mass": 1.0}}, "no parameter .mass.*; there are quadrotor_mass"),
    "a truth value": ({"parameters": {"bob_mass": True}}, r"'bob_mass'.* a number from .* not True"),
    "negative mass": (
        {"parameters": {"bob_mass": -1.0}},
        r"'bob_mass'.* a number from 1e-10 to 10000 kg(, or \d of them)?, not -1.0",
    ),
}
BAD_MASKS: dict[str, tuple[Any, str]] = {
    "wrong type": ([1, 0, 1], "'reset_mask'.* boolean array"),
    "wrong shape": (np.ones(2, np.bool_), r"'reset_mask'.* shape \(3,\)"),
    "empty": (np.zeros(3, np.bool_), "'reset_mask'.* True"),
}
BAD_ARGUMENTS: dict[str, tuple[dict[str, Any], str]] = {
    "unknown task": ({"task": "swim"}, "no task 'swim'; there are track, hover"),
    "unknown field of a task": ({"task": {"limits": {"angle": 1}}}, "limits has no field 'angle'"),
    "field of a part": ({"reward": {"yaw": 1.0}}, r"no field 'reward' \(did you mean 'task.reward'\?\)"),
    "unknown wind": ({"wind": "gale"}, "no wind 'gale'; there are calm, breeze, windy, storm"),
    "wind of an unknown kind": ({"wind": {"kind": "gale"}}, "'gale'.*constant, sinusoid"),
    "render mode": ({"render_mode": "ansi"}, "render_mode must .* not 'ansi'"),
}


@pytest.fixture
def single() -> Any:
    """A windy environment during an episode."""
    env = make_unwrapped(wind=WINDY, task=ENDLESS)
    env.reset(seed=1)
    run_actions(env, draw_actions(0, 5))
    return env


@pytest.fixture
def vector() -> Any:
    """A windy vector environment during an episode."""
    env = make_vec(3, wind=WINDY)
    env.reset(seed=1)
    run_actions(env, draw_actions(0, 5, 3))
    return env


def assert_refused_unchanged(env: Any, call: Callable[[], Any], names: str) -> None:
    """Assert that `call` is refused and that `env` then behaves as a copy made before the call."""
    before = copy.deepcopy(env)
    assert_refused(call, names)
    assert_array_equal(env.world.state, before.world.state)
    actions = draw_actions(2, 10, *env.action_space.shape[:-1])
    assert_same(run_actions(env, actions), run_actions(before, actions))
    assert_same(env.reset(), before.reset())


@pytest.mark.parametrize(("value", "names"), BAD_ACTIONS.values(), ids=BAD_ACTIONS.keys())
def test_a_bad_action_is_refused(single: Any, value: Any, names: str) -> None:
    assert_refused_unchanged(single, lambda: single.step(value), names)


def test_a_bad_action_of_a_vector_env_names_its_row(vector: Any) -> None:
    actions = np.zeros((3, 4))
    actions[1, 2] = 1.5
    assert_refused_unchanged(vector, lambda: vector.step(actions), "action of sub-environment 1 .* not .* 1.5")
    assert_refused_unchanged(vector, lambda: vector.step(np.zeros(4)), r"action must be numbers of shape \(3, 4\)")


@pytest.mark.parametrize(("value", "names"), BAD_OPTIONS.values(), ids=BAD_OPTIONS.keys())
def test_a_bad_option_is_refused(single: Any, vector: Any, value: Any, names: str) -> None:
    for env in (single, vector):
        assert_refused_unchanged(env, lambda env=env: env.reset(seed=9, options=value), names)


@pytest.mark.parametrize(("value", "names"), BAD_MASKS.values(), ids=BAD_MASKS.keys())
def test_a_bad_mask_is_refused(vector: Any, value: Any, names: str) -> None:
    assert_refused_unchanged(vector, lambda: vector.reset(options={"reset_mask": value}), names)


@pytest.mark.parametrize("seed", [-1, 1.0, "one"])
def test_a_bad_seed_is_refused(single: Any, vector: Any, seed: Any) -> None:
    assert_refused_unchanged(single, lambda: single.reset(seed=seed), "(?i)seed")
    assert_refused_unchanged(vector, lambda: vector.reset(seed=[1, 2, seed]), "(?i)seed")


@pytest.mark.filterwarnings("ignore:.*render_mode")
@pytest.mark.parametrize(("value", "names"), BAD_ARGUMENTS.values(), ids=BAD_ARGUMENTS.keys())
def test_a_bad_argument_is_refused(value: Any, names: str) -> None:
    assert_refused(lambda: make(**value), names)
    assert_refused(lambda: make_vec(2, **value), names)


def test_a_step_before_the_first_reset_is_refused() -> None:
    assert_refused(lambda: make_unwrapped().step(np.zeros(4)), "call reset before step", ResetNeeded)


def test_an_ended_sub_environment_cannot_be_stepped_when_autoreset_is_disabled() -> None:
    env = make_vec(2, autoreset_mode="Disabled", max_episode_steps=2)
    env.reset(seed=0)
    run_actions(env, np.zeros((2, 2, 4)))
    env.reset(options={"reset_mask": np.array([True, False])})
    assert_refused(lambda: env.step(np.zeros((2, 4))), "sub-environment 1 is over: reset it", ResetNeeded)
