"""Wrong input raises an error of one sentence that names it, and leaves the environment unchanged."""

import copy
import re
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from quadpend_gym import (
    Actuators,
    Constant,
    Limits,
    OrnsteinUhlenbeck,
    PaperGusts,
    Parameters,
    Reference,
    ReferenceSettings,
    RewardWeights,
    Simulation,
    Sinusoid,
    StartSettings,
    Task,
)
from quadpend_gym.wind import Sum
from quadpend_gym.wrappers import VectorWindWrapper, WindWrapper
from tests.helpers.bad_input import (
    BAD_ACTIONS,
    INF,
    NAN,
    ROWS,
    ZEROS,
    Table,
    assert_refused,
    assert_refused_unchanged,
    cases,
    with_action,
)
from tests.helpers.envs import ENDLESS, WINDY, assert_same, draw_actions, make, make_unwrapped, make_vec, run_actions

BAD_VECTOR_ACTIONS: Table = {
    "nan in the first action": (with_action(0, NAN, 0, 0, 0), ValueError, "action of sub-environment 0 .*nan"),
    "nan in the last action": (with_action(2, 0, 0, 0, NAN), ValueError, "action of sub-environment 2 .* nan"),
    "infinite": (with_action(1, 0, -INF, 0, 0), ValueError, "action of sub-environment 1 .* -inf"),
    "too large": (with_action(1, 0, 0, 1.5, 0), ValueError, r"action of sub-environment 1 .* \[-1, 1\], not .* 1.5"),
    "one for all": (np.zeros(4), ValueError, r"action must have shape \(3, 4\), not \(4,\)"),
    "too many rows": (np.zeros((4, 4)), ValueError, r"action must have shape \(3, 4\), not \(4, 4\)"),
    "text": ("hover", TypeError, "action must contain only numbers"),
}
BAD_OPTIONS: Table = {
    "unknown option": ({"wind": None}, ValueError, "no option 'wind'; the options are state, reference"),
    "option that is not text": ({3: None}, ValueError, "no option 3"),
    "not a dict": ([("state", {})], TypeError, "options must be a dict"),
    "state not a mapping": ({"state": [0, 0, 2]}, TypeError, r"options\['state'\] must be a mapping"),
    "unknown field": ({"state": {"speed": (0, 0, 0)}}, ValueError, "no field 'speed'; the fields are position"),
    "short field": ({"state": {"position": (0, 0)}}, ValueError, r"'position'.* shape .* not \(2,\)"),
    "scalar field": ({"state": {"euler": 0.0}}, ValueError, r"'euler'.* shape .* not \(\)"),
    "too many rows": ({"state": {"euler": np.zeros((7, 3))}}, ValueError, r"'euler'.* shape .* not \(7, 3\)"),
    "nan": ({"state": {"velocity": (0, NAN, 0)}}, ValueError, "'velocity'.* finite.* nan"),
    "infinite": ({"state": {"velocity": (0, INF, 0)}}, ValueError, "'velocity'.* finite.* inf"),
    "too large": ({"state": {"velocity": (0, 1e300, 0)}}, ValueError, "'velocity'.* between"),
    "text": ({"state": {"velocity": "fast"}}, TypeError, "'velocity'.* numbers, not 'fast'"),
    "zero direction": ({"state": {"direction": (0, 0, 0)}}, ValueError, "'direction'.* zero"),
    "bad after good": ({"state": {"position": (9, 9, 9), "euler": NAN}}, ValueError, "'euler'"),
    "reference of the wrong type": ({"reference": "circle"}, TypeError, "reference must be a Reference"),
    "reference with an unknown field": ({"reference": {"radius": 1.0}}, ValueError, "reference has no field 'radius'"),
    "reference with a nan": ({"reference": {"offset": NAN}}, ValueError, "offset must be a finite number"),
    "reference too short": ({"reference": {"offset": (0, 0, 2)}}, TypeError, "offset must be a number or 4 numbers"),
    "too many references": ({"reference": [Reference()] * 9}, ValueError, "reference.* not 9"),
    "bad reference with a good state": ({"state": {"position": (9, 9, 9)}, "reference": 5}, TypeError, "reference"),
}
MASK = np.ones(ROWS, np.bool_)
BAD_VECTOR_OPTIONS: Table = {
    "mask of the wrong type": ({"reset_mask": [True] * ROWS}, ValueError, "'reset_mask'.* boolean array"),
    "mask of numbers": ({"reset_mask": np.ones(ROWS)}, ValueError, "'reset_mask'.* boolean array"),
    "mask of the wrong shape": ({"reset_mask": np.ones(2, np.bool_)}, ValueError, r"'reset_mask'.* shape \(3,\)"),
    "empty mask": ({"reset_mask": ~MASK}, ValueError, "'reset_mask'.* True"),
    "zero direction in one sub-environment": (
        {"state": {"direction": [(0, 0, 1), (0, 0, 0), (0, 0, 1)]}},
        ValueError,
        "'direction'.* zero",
    ),
    "more values than sub-environments that are reset": (
        {"reset_mask": np.arange(ROWS) == 1, "state": {"position": np.zeros((ROWS, 3))}},
        ValueError,
        r"'position'.* shape \(3,\) or \(1, 3\)",
    ),
}
BAD_SEEDS = {"negative": -1, "float": 1.0, "text": "one", "list": [1]}
BAD_VECTOR_SEEDS = {
    "negative": -1,
    "float": 1.0,
    "text": "one",
    "set": {1, 2, 3},
    "too few": [1, 2],
    "too many": [1, 2, 3, 4],
    "negative in a list": [1, -2, None],
    "float in a list": [1, 2, 3.5],
    "text in a list": ["a", "b", "c"],
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
    env = make_vec(ROWS, wind=WINDY)
    env.reset(seed=1)
    run_actions(env, draw_actions(0, 5, ROWS))
    return env


@cases(BAD_ACTIONS)
def test_a_bad_action_is_refused(single: Any, value: Any, kind: Any, names: str) -> None:
    assert_refused_unchanged(single, lambda: single.step(value), names, kind)


@cases(BAD_VECTOR_ACTIONS)
def test_a_bad_action_of_a_vector_env_is_refused(vector: Any, value: Any, kind: Any, names: str) -> None:
    assert_refused_unchanged(vector, lambda: vector.step(value), names, kind)


@pytest.mark.parametrize("seed", [None, 9])
@cases(BAD_OPTIONS)
def test_a_bad_option_is_refused(single: Any, seed: Any, value: Any, kind: Any, names: str) -> None:
    assert_refused_unchanged(single, lambda: single.reset(seed=seed, options=value), names, kind)


@pytest.mark.parametrize("seed", [None, 9, [7, 8, 9]])
@cases({**BAD_OPTIONS, **BAD_VECTOR_OPTIONS})
def test_a_bad_option_of_a_vector_env_is_refused(vector: Any, seed: Any, value: Any, kind: Any, names: str) -> None:
    assert_refused_unchanged(vector, lambda: vector.reset(seed=seed, options=value), names, kind)


@pytest.mark.parametrize("seed", BAD_SEEDS.values(), ids=BAD_SEEDS.keys())
def test_a_bad_seed_is_refused(single: Any, seed: Any) -> None:
    options = {"state": {"position": (9.0, 9.0, 9.0)}}
    assert_refused_unchanged(single, lambda: single.reset(seed=seed, options=options), "(?i)seed")


@pytest.mark.parametrize("seed", BAD_VECTOR_SEEDS.values(), ids=BAD_VECTOR_SEEDS.keys())
def test_a_bad_seed_of_a_vector_env_is_refused(vector: Any, seed: Any) -> None:
    options = {"state": {"position": (9.0, 9.0, 9.0)}}
    assert_refused_unchanged(vector, lambda: vector.reset(seed=seed, options=options), "(?i)seed")


def test_a_bad_option_before_the_first_reset_changes_nothing() -> None:
    env, fresh = make_vec(ROWS), make_vec(ROWS)
    assert_refused(lambda: env.reset(seed=5, options={"state": {"height": 1.0}}), "height")
    assert_refused(lambda: env.step(ZEROS), "call reset", ResetNeeded)
    assert_same(env.reset(seed=[1, 2, 3]), fresh.reset(seed=[1, 2, 3]))


BAD_ARGUMENTS: Table = {
    "unknown task": ({"task": "swim"}, ValueError, "no task 'swim'; the tasks are track, hover"),
    "task of the wrong type": ({"task": 3}, TypeError, "task must be a Task"),
    "task with an unknown field": ({"task": {"goal": 1}}, ValueError, "task has no field 'goal'"),
    "deep unknown field": ({"task": {"limits": {"angle": 1}}}, ValueError, "limits has no field 'angle'"),
    "simulation of the wrong type": ({"simulation": "fast"}, TypeError, "simulation must be a Simulation"),
    "simulation with an unknown field": ({"simulation": {"dt": 0.1}}, ValueError, "simulation has no field 'dt'"),
    "parameters of the wrong type": ({"simulation": {"parameters": 1}}, TypeError, "parameters must be a Parameters"),
    "wind of the wrong type": ({"wind": 3.0}, TypeError, "wind must be a wind model,.* not 3.0"),
    "wind of an unknown name": ({"wind": "gale"}, ValueError, "no wind 'gale'; there are calm, breeze, windy, storm"),
    "wind class instead of a model": ({"wind": Constant}, TypeError, "wind must be a wind model,.* not .*Constant"),
    "wind without a kind": ({"wind": {"force": 1.0}}, ValueError, "no kind None; the kinds are constant"),
    "wind of an unknown kind": ({"wind": {"kind": "storm"}}, ValueError, "no kind 'storm'"),
    "wind with an unknown field": ({"wind": {"kind": "constant", "gust": 1}}, ValueError, "wind has no field 'gust'"),
    "render_mode": ({"render_mode": "ansi"}, ValueError, "render_mode must .* not 'ansi'"),
}
BAD_VECTOR_ARGUMENTS: Table = {
    "no sub-environments": ({"num_envs": 0}, ValueError, "num_envs must .* not 0"),
    "fractional number of sub-environments": ({"num_envs": 1.5}, ValueError, "num_envs must .* not 1.5"),
    "no steps": ({"max_episode_steps": 0}, ValueError, "max_episode_steps must .* not 0"),
    "fractional number of steps": ({"max_episode_steps": 10.0}, ValueError, "max_episode_steps must .* not 10.0"),
    "unknown autoreset mode": ({"autoreset_mode": "never"}, ValueError, "autoreset_mode must .* not 'never'"),
}


@pytest.mark.filterwarnings("ignore:.*render_mode")
@cases(BAD_ARGUMENTS)
def test_a_bad_argument_is_refused(value: Any, kind: Any, names: str) -> None:
    assert_refused(lambda: make(**value), names, kind)
    assert_refused(lambda: make_vec(2, **value), names, kind)


@cases(BAD_VECTOR_ARGUMENTS)
def test_a_bad_argument_of_a_vector_env_is_refused(value: Any, kind: Any, names: str) -> None:
    assert_refused(lambda: make_vec(**{"num_envs": 2, **value}), names, kind)


IMPOSSIBLE: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    *((Parameters, {name: value}) for name in Parameters.__dataclass_fields__ for value in (-1.0, NAN, INF, "1")),
    *((Parameters, {name: 0.0}) for name in Parameters.__dataclass_fields__ if not name.endswith("drag_area")),
    *((Actuators, {name: value}) for name in Actuators.__dataclass_fields__ for value in (-1.0, NAN, True)),
    *((Simulation, {"period": value}) for value in (0.0, -0.01, NAN, None)),
    *((Simulation, {"substeps": value}) for value in (0, -1, 1.5, "2")),
    *((StartSettings, {name: value}) for name in StartSettings.__dataclass_fields__ for value in (-0.1, NAN, "wide")),
    (StartSettings, {"direction": 1.0}),
    *((RewardWeights, {name: value}) for name in RewardWeights.__dataclass_fields__ for value in (-1.0, INF)),
    *((Limits, {name: value}) for name in Limits.__dataclass_fields__ for value in (NAN, "far")),
    *((Limits, {"pendulum_angle": value}) for value in (-0.1, 4.0)),
    (ReferenceSettings, {"height": (3.0, 2.0)}),
    (ReferenceSettings, {"height": (-1.0, 2.0)}),
    (ReferenceSettings, {"height": 2.0}),
    (ReferenceSettings, {"radius": (0.0, 1.0)}),
    (ReferenceSettings, {"acceleration": (0.0, INF)}),
    (ReferenceSettings, {"climb": (0.0, 0.1, 0.2)}),
    (ReferenceSettings, {"helix": -1.0}),
    (Task, {"limits": 3.0}),
    (Reference, {"offset": (0.0, 0.0, NAN, 0.0)}),
    (Reference, {"phase": "late"}),
    (Reference, {"rate": (1.0, 2.0)}),
    (Constant, {"force": NAN}),
    (Constant, {"torque": (1.0, 2.0)}),
    (Constant, {"bob_force": "strong"}),
    (Sinusoid, {"frequency": 0.0}),
    (OrnsteinUhlenbeck, {"time_constant": -1.0}),
    (PaperGusts, {"onset": -1.0}),
    (PaperGusts, {"hold": 0.0}),
    (PaperGusts, {"yaw_torque": NAN}),
]


@pytest.mark.parametrize(("kind", "value"), IMPOSSIBLE, ids=[f"{kind.__name__}({value})" for kind, value in IMPOSSIBLE])
def test_an_impossible_setting_is_refused(kind: Callable[..., Any], value: dict[str, Any]) -> None:
    assert_refused(lambda: kind(**value), next(iter(value)), (TypeError, ValueError))


@pytest.mark.parametrize(
    ("kind", "weights"),
    [
        (ReferenceSettings, dict.fromkeys(("hover", "circle", "figure_eight", "helix"), 0.0)),
        (RewardWeights, dict.fromkeys(RewardWeights.__dataclass_fields__, 0.0)),
    ],
)
def test_weights_must_not_all_be_zero(kind: Any, weights: dict[str, float]) -> None:
    assert_refused(lambda: kind(**weights), "above zero", ValueError)


def test_a_sum_accepts_wind_models_only() -> None:
    assert_refused(lambda: Sum((Constant(), 3.0)), "wind must be a wind model,.* not 3.0", TypeError)
    assert_refused(lambda: Constant() + "gust", "no wind 'gust' .did you mean 'gusts'..; there are calm", ValueError)


def test_a_step_before_the_first_reset_is_refused() -> None:
    assert_refused(lambda: make_unwrapped().step(np.zeros(4)), "call reset before step", ResetNeeded)
    env = make_vec(ROWS)
    env.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    assert_refused(lambda: env.step(ZEROS), "sub-environment 1 .* call reset before step", ResetNeeded)


def test_a_step_after_wind_is_added_needs_a_reset(single: Any, vector: Any) -> None:
    assert_refused(lambda: WindWrapper(single, Constant()).step(np.zeros(4)), "call reset before step", ResetNeeded)
    assert_refused(lambda: VectorWindWrapper(vector, Constant()).step(ZEROS), "call reset before step", ResetNeeded)


def test_wind_wrappers_accept_quadpendulum_environments_only() -> None:
    assert_refused(lambda: WindWrapper(gym.make("CartPole-v1"), Constant()), "QuadPendulum", TypeError)
    assert_refused(lambda: VectorWindWrapper(gym.make_vec("CartPole-v1"), Constant()), "QuadPendulum", TypeError)


def test_bad_wind_in_a_wrapper_changes_nothing(single: Any, vector: Any) -> None:
    assert_refused_unchanged(single, lambda: WindWrapper(single, "gale"), "no wind 'gale'")
    assert_refused_unchanged(vector, lambda: VectorWindWrapper(vector, {"kind": "gale"}), "no kind 'gale'")


def test_an_ended_sub_environment_cannot_be_stepped_when_autoreset_is_disabled() -> None:
    env = make_vec(ROWS, wind=WINDY, autoreset_mode="Disabled", max_episode_steps=5)
    env.reset(seed=0)
    run_actions(env, np.zeros((4, ROWS, 4)))
    env.reset(options={"reset_mask": np.array([True, False, False])})
    env.step(ZEROS)
    env.reset(options={"reset_mask": np.array([True, False, False])})
    clone = copy.deepcopy(env)
    assert_refused(
        lambda: env.step(ZEROS),
        re.escape("sub-environment 1 is over: reset it with options={'reset_mask'"),
        ResetNeeded,
    )
    for other in (env, clone):
        other.reset(options={"reset_mask": np.array([False, True, True])})
    assert_same(run_actions(env, np.zeros((3, ROWS, 4))), run_actions(clone, np.zeros((3, ROWS, 4))))
