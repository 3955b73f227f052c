"""The single environment: Gymnasium's interface, actions, observations and reset options."""

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_with_gymnasium
from gymnasium.wrappers import RescaleObservation
from numpy.testing import assert_allclose, assert_array_equal
from stable_baselines3.common.env_checker import check_env as check_with_sb3

from quadpend_gym import PAPER, Reference
from quadpend_gym.physics.state import STATE_FIELDS
from quadpend_gym.tasks.task import ENVIRONMENTS, TASKS
from tests.helpers.envs import (
    AT_REST,
    IDS,
    WINDY,
    assert_same,
    draw_actions,
    make,
    make_unwrapped,
    make_vec,
    run_actions,
)


@pytest.mark.filterwarnings("ignore:.*A Box observation space .* is -?inf")  # as for Gymnasium's MuJoCo environments
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("wind", [None, WINDY], ids=["calm", "windy"])
@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("check", [check_with_gymnasium, check_with_sb3])
def test_environment_checkers_give_no_other_warning(check: Callable[[Any], None], name: str, wind: Any) -> None:
    check(gym.make(name, wind=wind).unwrapped)


def test_wrappers_that_need_bounds_of_the_observation_refuse_it() -> None:
    with pytest.raises(ValueError, match="unbounded"):
        RescaleObservation(make(), -1.0, 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("wind", [None, WINDY], ids=["calm", "windy"])
@pytest.mark.parametrize("rows", [None, 3], ids=["single", "vector"])
def test_returned_arrays_are_independent_of_the_environment(rows: int | None, wind: Any) -> None:
    """The environment never writes into returned arrays, and writing into them does not change the environment."""
    env: Any = make_vec(3, wind=wind, max_episode_steps=8, autoreset_mode="SameStep") if rows else make(wind=wind)
    steps = (5, rows) if rows else (5,)
    returned = [
        env.reset(seed=0),
        *run_actions(env, draw_actions(0, *steps)),
        *run_actions(env, draw_actions(1, *steps)),
    ]
    kept, duplicate = copy.deepcopy(returned), copy.deepcopy(env)
    after = run_actions(duplicate, draw_actions(2, *steps)), duplicate.reset()
    overwrite(returned)
    assert_same((run_actions(env, draw_actions(2, *steps)), env.reset()), after)
    overwrite(kept)
    assert_same(returned, kept)


def overwrite(data: Any) -> None:
    """Overwrite every array in nested tuples, lists and dicts."""
    if isinstance(data, np.ndarray):
        data[...] = 0 if data.dtype == bool else 77
    elif isinstance(data, dict | list | tuple):
        for item in data.values() if isinstance(data, dict) else data:
            overwrite(item)


@pytest.mark.parametrize("action", [*np.diag([-1.0, -1.0, 1.0, -1.0]), np.array([0.5, 0.0, 0.0, 0.0]), np.zeros(4)])
def test_actions_command_the_documented_thrust_and_torques(action: Any) -> None:
    """From upright rest the vertical acceleration is a₀ g, and the torques are 5, 5 and 1 N·m at 0.1 kg·m²."""
    env = make_unwrapped()
    env.reset(seed=0, options={"state": AT_REST})
    env.step(action)
    tilted = 1e-7 * np.abs(action[1:]).max()  # m/s, the cosine of an angle of 1.3 mrad
    assert_allclose(env.state.velocity[2], action[0] * PAPER.gravity * 0.01, rtol=1e-12, atol=1e-15 + tilted)
    assert_allclose(env.state.euler_rate, action[1:] * [0.5, 0.5, 0.1], rtol=1e-12)


@pytest.mark.parametrize("name", STATE_FIELDS)
def test_reset_sets_the_given_state_field_and_draws_the_others(name: str) -> None:
    env = make_unwrapped()
    env.reset(seed=4)
    drawn = env.state.array.copy()
    value = {"direction": (0.6, 0.0, 0.8), "direction_rate": (0.0, 0.0, 0.0)}.get(name, (0.3, -0.2, 0.1))
    env.reset(seed=4, options={"state": {name: value}})
    assert_allclose(getattr(env.state, name), value, atol=1e-15)
    for other in STATE_FIELDS.keys() - {name, "direction_rate"}:
        assert_array_equal(getattr(env.state, other), drawn[STATE_FIELDS[other]])


def test_reset_normalises_the_direction_and_projects_its_rate() -> None:
    env = make_unwrapped()
    env.reset(seed=4, options={"state": {"direction": (3.0, 0.0, 4.0), "direction_rate": (1.0, 2.0, 0.0)}})
    assert_allclose(env.state.direction, (0.6, 0.0, 0.8), atol=1e-15)
    assert_allclose(env.state.direction_rate, (0.64, 2.0, -0.48), atol=1e-15)


def test_reset_with_a_reference_draws_the_same_deviation_from_it() -> None:
    env = make_unwrapped()
    env.reset(seed=4, options={"reference": Reference.hover(x=0.5)})
    here = env.state.array.copy()
    env.reset(seed=4, options={"reference": {"offset": [1.5, 0.0, 3.0, 0.0]}})
    assert_array_equal(env.world.reference[0], Reference.hover(x=1.5, z=3.0).as_array())
    moved = env.state.array - here
    assert_allclose(moved, np.eye(18)[0] + np.eye(18)[2], atol=1e-14)


def test_each_sub_environment_can_have_its_own_start_and_reference() -> None:
    env = make_vec(3)
    positions = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]])
    references = [Reference.hover(x=float(row)) for row in range(3)]
    env.reset(seed=0, options={"state": {"position": positions}, "reference": references})
    assert_array_equal(env.state.position, positions)
    assert_array_equal(env.world.reference, [reference.as_array() for reference in references])


def test_reset_sets_physical_parameters_of_one_episode() -> None:
    env = make_vec(2)
    env.reset(seed=0, options={"parameters": {"bob_mass": 0.25, "rod_length": [0.2, 0.4]}})
    expected = [PAPER._replace(bob_mass=0.25, rod_length=length) for length in (0.2, 0.4)]
    assert_array_equal(env.world.parameters, expected)
    env.reset()
    assert_array_equal(env.world.parameters, [PAPER] * 2)


def test_reset_options_apply_to_one_episode_only() -> None:
    env, other = make(), make()
    env.reset(seed=1, options={"state": {"position": (0.0, 0.0, 9.0)}, "reference": Reference.hover(x=1.0)})
    other.reset(seed=1)
    assert_same(env.reset(), other.reset())


def test_tilt_is_exact_from_upright_to_hanging() -> None:
    env = make_unwrapped()
    for angle in (0.0, 1e-9, 0.1, 1.0, 2.0, np.pi):
        direction = (np.sin(angle), 0.0, np.cos(angle))
        _, info = env.reset(seed=0, options={"state": {"direction": direction}})
        assert_allclose(info["tilt"], angle, rtol=1e-7, atol=1e-15)


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_a_mapping_changes_the_task_of_the_id(env_id: str) -> None:
    own = TASKS[ENVIRONMENTS[env_id]]
    env: Any = gym.make(env_id, task={"reward": {"effort": 0.3}}).unwrapped
    assert env.scenario.task == replace(own, reward=replace(own.reward, effort=0.3))
    assert gym.make(env_id, scenario="windy").unwrapped.scenario.task == own  # type: ignore[attr-defined]
