"""Environments with and without wrappers: rows equal single environments, in any order, from objects and from data."""

import copy
import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from numpy.testing import assert_array_equal
from stable_baselines3.common.env_checker import check_env as check_with_sb3

from quadpend_gym import Waypoints
from quadpend_gym.actuators import ActionDelay, GyroBias, PacketLoss
from quadpend_gym.core.arrays import Booleans
from quadpend_gym.vehicles import VEHICLES
from tests.helpers.envs import (
    AUTORESET_MODES,
    assert_same,
    draw_actions,
    run_actions,
)
from tests.helpers.random_settings import INTERFACES
from tests.helpers.wrappers import (
    ACTUATORS,
    PARAMETERS,
    SENSORS,
    SHORT,
    STACKS,
    TURBULENCE,
    WIND,
    Layers,
    biased_actions,
    make_sync_vec,
    make_wrapped,
    make_wrapped_vec,
)

ROWS, STEPS = 5, 50
TRAJECTORY = Waypoints((0, 0.15, 0.4), ((0, 0, 2), (4e-6, 0, 2, 1e-3), (2e-5, 2e-5, 2.0002)))
RIGID = [name for name, vehicle in VEHICLES.items() if vehicle.attitude == "rigid"]
RATES = {"vehicle": "x500", "interface": "body_rates", "latency": 0.035}
REAL = [TURBULENCE, PARAMETERS, ("actuators", [PacketLoss(0.2), ActionDelay(), GyroBias(0.1)]), SENSORS]
CASES: dict[str, tuple[Layers, dict[str, Any]]] = {
    "none": ([], SHORT),
    **{name: (layers, SHORT) for name, layers in STACKS.items()},
    "waypoints": ([WIND], {**SHORT, "task": replace(SHORT["task"], trajectory=TRAJECTORY)}),
    **{
        f"{vehicle}, {interface}, {latency} s": (
            [],
            {**SHORT, "vehicle": vehicle, "interface": interface, "latency": latency},
        )
        for vehicle, interface, latency in zip(RIGID, cycle(INTERFACES), cycle((0.0, 0.035, 0.005, 0.02)), strict=False)
    },
    "x500, all": (REAL, {**SHORT, **RATES}),
}
cases = pytest.mark.parametrize(("layers", "kwargs"), CASES.values(), ids=CASES.keys())
ALL = np.ones(ROWS, np.bool_)
stacks = pytest.mark.parametrize("layers", STACKS.values(), ids=STACKS.keys())
modes = pytest.mark.parametrize("mode", AUTORESET_MODES)
WORLD = {"wind": WIND, "sensors": SENSORS, "actuators": ACTUATORS, "parameters": PARAMETERS}


def assert_same_info(ours: dict[str, Any], theirs: dict[str, Any], mask: Booleans) -> None:
    """Assert the same keys, masks and types, and the same values where the masks are true."""
    assert ours.keys() == theirs.keys()
    for key in ours:
        if isinstance(ours[key], dict):
            assert_same_info(ours[key], theirs[key], ours[f"_{key}"])
        elif key.startswith("_"):
            assert_array_equal(ours[key], theirs[key])
        else:
            assert ours[key].dtype == theirs[key].dtype
            assert_same(ours[key][ours[f"_{key}"]], theirs[key][theirs[f"_{key}"]])


@modes
@cases
def test_every_row_equals_a_single_environment(layers: Layers, kwargs: dict[str, Any], mode: str) -> None:
    """To the last bit, with `final_obs` and `final_info`, across several terminations and truncations."""
    env = make_wrapped_vec(ROWS, layers, autoreset_mode=mode, **kwargs)
    theirs = make_sync_vec(ROWS, layers, mode, **kwargs)
    for space in ("observation_space", "single_observation_space", "action_space"):
        assert getattr(env, space) == getattr(theirs, space)
    (observation, info), (their_observation, their_info) = env.reset(seed=9), theirs.reset(seed=9)
    assert_same(observation, their_observation)
    assert_same_info(info, their_info, ALL)
    ends = []
    for actions in biased_actions(STEPS, ROWS):
        *returned, info = env.step(actions)
        *their_return, their_info = theirs.step(actions)
        assert_same(returned, their_return)
        assert_same_info(info, their_info, ALL)
        over: Booleans = returned[2] | returned[3]
        ends.append(np.array(returned[2:]))
        if mode == "Disabled" and over.any():
            observation, info = env.reset(options={"reset_mask": over})
            their_observation, their_info = theirs.reset(options={"reset_mask": over})
            assert_same(observation, their_observation)
            assert_same_info(info, their_info, over)
    assert np.sum(ends, axis=(0, 2)).all() or "vehicle" in kwargs
    assert np.sum(ends, axis=(0, 1)).min() >= 2


@stacks
def test_an_episode_depends_only_on_its_seed_and_number(layers: Layers) -> None:
    """Actions of earlier episodes do not change it."""
    env, duplicate = make_wrapped(layers), make_wrapped(layers)
    for k, seed in enumerate((5, None, None)):
        assert_same(env.reset(seed=seed), duplicate.reset(seed=seed))
        run_actions(env, draw_actions(k, 5 * k + 3))
    assert_same(env.reset(), duplicate.reset())
    actions = draw_actions(9, 10)
    assert_same(run_actions(env, actions), run_actions(duplicate, actions))


@stacks
def test_stable_baselines3_checker_gives_no_warning(layers: Layers) -> None:
    with warnings.catch_warnings(action="error"):
        check_with_sb3(make_wrapped(layers))


@pytest.mark.parametrize(("layers", "kwargs"), [*CASES.values(), ([], {"scenario": "noisy", "max_episode_steps": 7})])
def test_specifications_survive_json(layers: Layers, kwargs: dict[str, Any]) -> None:
    """That of a single environment with its wrappers, and of a vector environment without."""
    env = make_wrapped(layers, **kwargs)
    parts = [part for part in layers if not part[0].endswith("Wrapper")]
    rows = make_wrapped_vec(3, parts, autoreset_mode="SameStep", **kwargs)
    for one, make, shape in ((env, gym.make, ()), (rows, gym.make_vec, (3,))):
        assert one.spec is not None
        duplicate = make(EnvSpec.from_json(one.spec.to_json()))  # type: ignore[operator]
        assert str(duplicate) == str(one)
        assert_same(duplicate.reset(seed=3), one.reset(seed=3))
        actions = draw_actions(3, 10, *shape)
        assert_same(run_actions(duplicate, actions), run_actions(one, actions))


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
@stacks
def test_copy_made_during_an_episode_continues_identically(layers: Layers, clone: Callable[[Any], Any]) -> None:
    env: Any
    for env, rows in ((make_wrapped(layers), ()), (make_wrapped_vec(3, layers, **SHORT), (3,))):
        env.reset(seed=5)
        run_actions(env, draw_actions(0, 10, *rows))
        duplicate = clone(env)
        actions = draw_actions(1, 20, *rows)
        assert_same(run_actions(duplicate, actions), run_actions(env, actions))
        assert_same(duplicate.reset(), env.reset())


@pytest.mark.parametrize("added", WORLD.values(), ids=WORLD.keys())
def test_every_part_has_its_own_random_stream(added: Any) -> None:
    """What is drawn for the other parts of an episode is the same without it, also after other actions."""
    whole, fewer = (
        make_wrapped_vec(5, layers)
        for layers in (list(WORLD.values()), [part for part in WORLD.values() if part != added])
    )
    mine, theirs = whole.unwrapped.world, fewer.unwrapped.world
    for seed in (0, None):
        whole.reset(seed=seed), fewer.reset(seed=seed)
        assert_array_equal(mine.reference, theirs.reference)
        assert_array_equal(mine.state[:, 2:12:3], theirs.state[:, 2:12:3])  # height and yaw, which no rod changes
        assert (mine.wind == theirs.wind).all() == (added != WIND)
        assert (mine.parameters == theirs.parameters).all() == (added != PARAMETERS)
        run_actions(whole, draw_actions(0, 3, 5)), run_actions(fewer, draw_actions(1, 5, 5))
