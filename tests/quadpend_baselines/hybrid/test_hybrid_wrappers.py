"""Wrappers of hybrids: the vector wrapper equals single environments in every autoreset mode, and errors are clear."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import SyncVectorEnv, VectorEnv
from numpy.testing import assert_array_equal

from quadpend_baselines import controller
from quadpend_baselines.hybrid import (
    BandwidthScheduling,
    EstimateOnly,
    Hybrid,
    HybridWrapper,
    ResidualAction,
    VectorHybridWrapper,
)
from quadpend_gym import Simulation
from quadpend_gym.core.arrays import Floats32
from tests.helpers.bad_input import assert_refused
from tests.helpers.envs import AUTORESET_MODES, assert_same, draw_actions, make, make_vec, run_actions
from tests.helpers.wrappers import HISTORY, OUTPUTS, SENSORS, SHORT, WIND, Layers, make_wrapped, make_wrapped_vec

Make = Callable[[], Hybrid]
HYBRIDS: dict[str, Make] = {
    "estimate, adrc": lambda: EstimateOnly("adrc-matched"),
    "estimate, flatness": lambda: EstimateOnly("flatness"),
    "residual, adrc": lambda: ResidualAction("adrc-matched", 0.5),
    "residual, flatness": lambda: ResidualAction("flatness", 0.3),
    "residual, lqi": lambda: ResidualAction("lqi", 0.3),
    "scheduling": lambda: BandwidthScheduling("flatness", 1.0),
}
LAYERS: dict[str, Layers] = {"plain": [WIND], "sensors and outputs": [WIND, SENSORS, OUTPUTS]}
BRIEF = {**SHORT, "max_episode_steps": 9}
all_hybrids = pytest.mark.parametrize("hybrid", HYBRIDS.values(), ids=HYBRIDS.keys())
one_of_each = pytest.mark.parametrize(
    "hybrid", [HYBRIDS[name] for name in ("estimate, adrc", "residual, flatness", "scheduling")]
)
modes = pytest.mark.parametrize("mode", AUTORESET_MODES)
inner_layers = pytest.mark.parametrize("layers", LAYERS.values(), ids=LAYERS.keys())


def wrap(env: Any, hybrid: Make) -> Any:
    """`env`, an Env or a VectorEnv, in the wrapper of a hybrid."""
    return (VectorHybridWrapper if isinstance(env, VectorEnv) else HybridWrapper)(env, hybrid())


def make_sync_vec(rows: int, layers: Layers, hybrid: Make, mode: str) -> Any:
    """Gymnasium's vector environment of wrapped single environments: the oracle of the vector wrapper."""
    return SyncVectorEnv([lambda: wrap(make_wrapped(layers, **BRIEF), hybrid)] * rows, autoreset_mode=mode)


def biased_actions(steps: int, rows: int) -> Floats32:
    """Actions with another bias in each sub-environment, so that episodes end at different times."""
    return np.clip(0.3 * draw_actions(0, steps, rows) + draw_actions(1, rows), -1.0, 1.0)


@modes
@inner_layers
@one_of_each
def test_vector_wrapper_equals_wrapped_single_environments(hybrid: Make, layers: Layers, mode: str) -> None:
    """Exactly, across the ends of several episodes, final observations included."""
    rows = 3
    env = wrap(make_wrapped_vec(rows, layers, autoreset_mode=mode, **BRIEF), hybrid)
    theirs = make_sync_vec(rows, layers, hybrid, mode)
    assert env.single_observation_space == theirs.single_observation_space
    assert env.observation_space == theirs.observation_space
    assert env.action_space == theirs.action_space
    assert_array_equal(env.reset(seed=7)[0], theirs.reset(seed=7)[0])
    ended = np.zeros(rows, np.int64)
    for action in biased_actions(30, rows):
        *returned, info = env.step(action)
        *their_return, their_info = theirs.step(action)
        assert_same(returned, their_return)
        assert env.observation_space.contains(returned[0])
        over = returned[2] | returned[3]
        ended += over
        if mode == "SameStep":
            for row in np.flatnonzero(over):
                assert_array_equal(info["final_obs"][row], their_info["final_obs"][row])
                assert env.single_observation_space.contains(info["final_obs"][row])
        if mode == "Disabled" and over.any():
            mask = {"reset_mask": over}
            assert_array_equal(env.reset(options=mask)[0], theirs.reset(options=mask)[0])
    assert ended.min() >= 2


def test_a_base_controller_with_a_name_is_designed_for_the_environment_and_an_object_is_not() -> None:
    slow = Simulation(period=0.02)
    for env in (make(period=0.02), make_vec(2, period=0.02)):
        assert wrap(env, lambda: EstimateOnly("lqr")).hybrid.controller.simulation == slow
        assert wrap(env, lambda: EstimateOnly("lqr").as_data()).hybrid.controller.simulation == slow
        assert wrap(env, lambda: EstimateOnly(controller("lqr"))).hybrid.controller.simulation == Simulation()


@all_hybrids
def test_base_action_is_what_the_base_controller_would_apply(hybrid: Make) -> None:
    """Zero for bandwidth scheduling, which asks the base controller only after the policy."""
    env = wrap(make_vec(3, wind="windy"), hybrid)
    with pytest.raises(ResetNeeded):
        _ = env.base_action
    observation, _ = env.reset(seed=0)
    assert env.base_action.shape == (3, 4)
    if env.hybrid.kind == "bandwidth_scheduling":
        assert_array_equal(env.base_action, 0.0)
    else:
        expected, _ = controller(env.hybrid.base_controller).predict(make_vec(3, wind="windy").reset(seed=0)[0])
        assert_array_equal(env.base_action, expected)
    if env.hybrid.kind == "residual_action":
        assert_array_equal(observation[:, -4:], 10.0 * env.base_action)


@pytest.mark.parametrize("rows", [(), (3,)], ids=["one", "many"])
def test_actions_that_the_environment_would_refuse_change_nothing(rows: tuple[int, ...]) -> None:
    hybrid = HYBRIDS["residual, flatness"]
    env, copy = (wrap(make_vec(3) if rows else make(), hybrid) for _ in range(2))
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((*rows, 4)))
    env.reset(seed=0), copy.reset(seed=0)
    for bad, names in ((np.full((*rows, 4), 1.5), "four numbers"), (np.zeros((*rows, 3)), r"shape .*4")):
        with pytest.raises(ValueError, match=names):
            env.step(bad)
    actions = 0.1 * draw_actions(0, 3, *rows)
    assert_same(run_actions(env, actions), run_actions(copy, actions))


@inner_layers
@one_of_each
def test_spec_survives_json(hybrid: Make, layers: Layers) -> None:
    env = wrap(make_wrapped(layers, max_episode_steps=7), hybrid)
    assert env.spec is not None
    copy = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert str(copy) == str(env)
    assert_same(copy.reset(seed=3), env.reset(seed=3))
    actions = 0.1 * draw_actions(3, 7)
    assert_same(run_actions(copy, actions), run_actions(env, actions))


@pytest.mark.parametrize(
    ("env", "names"),
    [
        (lambda: make_wrapped([HISTORY]), "observations of 36 or 27 numbers, not of .*116.*: put its wrapper inside"),
        (lambda: gym.make("CartPole-v1"), "36 or 27 numbers"),
    ],
    ids=["a history", "another environment"],
)
def test_environments_with_other_observations_are_refused(env: Callable[[], Any], names: str) -> None:
    assert_refused(lambda: wrap(env(), HYBRIDS["scheduling"]), names, ValueError)
