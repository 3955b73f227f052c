"""Wrappers of hybrids: the vector wrapper equals single environments in every autoreset mode, and errors are clear."""

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env as check_with_gymnasium
from gymnasium.vector import SyncVectorEnv, VectorEnv
from numpy.testing import assert_array_equal
from stable_baselines3.common.env_checker import check_env as check_with_sb3

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
from tests.helpers.controllers import HybridPolicy, constant, run_policy
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
SIZES = {
    "estimate, adrc": 45,
    "estimate, flatness": 45,
    "residual, adrc": 49,
    "residual, flatness": 49,
    "residual, lqi": 49,
    "scheduling": 45,
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


@all_hybrids
def test_final_observation_belongs_to_the_ended_episode(hybrid: Make) -> None:
    """It equals the observation without the end of the episode, so the base controller has kept its memory."""
    short = wrap(make_vec(3, wind="windy", max_episode_steps=15, autoreset_mode="SameStep"), hybrid)
    long = wrap(make_vec(3, wind="windy", max_episode_steps=None, autoreset_mode="Disabled"), hybrid)
    assert_array_equal(short.reset(seed=0)[0], long.reset(seed=0)[0])
    for action in 0.1 * draw_actions(0, 15, 3):
        observation, _, _, truncated, info = short.step(action)
        expected = long.step(action)[0]
    assert truncated.all()
    assert_array_equal(np.stack(info["final_obs"]), expected)
    assert (observation != expected).any(axis=1).all()


@all_hybrids
def test_new_episode_does_not_depend_on_the_previous_one(hybrid: Make) -> None:
    envs = [wrap(make_vec(3, wind="windy", max_episode_steps=15, autoreset_mode="SameStep"), hybrid) for _ in range(2)]
    actions = 0.1 * draw_actions(0, 30, 3)
    runs = []
    for env, first in zip(envs, (actions[:15], -actions[:15]), strict=True):
        env.reset(seed=0)
        run_actions(env, first)
        runs.append([step[0] for step in run_actions(env, actions[15:29])])
    assert_same(*runs)


@one_of_each
def test_partial_reset_keeps_the_other_base_controllers(hybrid: Make) -> None:
    env, untouched = (wrap(make_vec(3, wind="windy"), hybrid) for _ in range(2))
    env.reset(seed=0), untouched.reset(seed=0)
    actions = 0.2 * draw_actions(0, 6, 3)
    seen = run_actions(env, actions)[-1][0]
    run_actions(untouched, actions)
    mask = np.array([False, True, False])
    begun, _ = env.reset(options={"reset_mask": mask})
    assert_array_equal(begun[~mask], seen[~mask])
    after, beside = run_actions(env, actions)[-1][0], run_actions(untouched, actions)[-1][0]
    assert_array_equal(after[~mask], beside[~mask])
    assert (after[mask] != beside[mask]).any()


@one_of_each
def test_with_next_step_autoreset_a_reset_sub_environment_is_not_reset_again(hybrid: Make) -> None:
    """The other ended sub-environments begin their next episode with the next step."""
    env = wrap(make_vec(3, wind="windy", max_episode_steps=4), hybrid)
    copy = wrap(make_vec(3, wind="windy", max_episode_steps=4, autoreset_mode="Disabled"), hybrid)
    env.reset(seed=0), copy.reset(seed=0)
    actions = 0.1 * draw_actions(0, 6, 3)
    run_actions(env, actions[:4]), run_actions(copy, actions[:4])
    mask = np.array([True, False, True])
    first = env.reset(options={"reset_mask": mask})[0][mask]
    assert_array_equal(first, copy.reset(options={"reset_mask": mask})[0][mask])
    begun, _ = copy.reset(options={"reset_mask": ~mask})
    seen = env.step(actions[4])[0]
    assert_array_equal(seen[~mask], begun[~mask])
    assert (seen[mask] != begun[mask]).any(axis=1).all()


@all_hybrids
@inner_layers
def test_wrapped_environment_equals_the_hybrid_on_the_plain_environment(hybrid: Make, layers: Layers) -> None:
    agent = constant(0.02, -0.01, 0.03, 0.1)
    plain = make_wrapped_vec(3, layers, autoreset_mode="SameStep", **SHORT)
    policy = HybridPolicy(hybrid(), agent)
    _, results = run_policy(policy, plain, 30)
    env = wrap(make_wrapped_vec(3, layers, autoreset_mode="SameStep", **SHORT), hybrid)
    observation, _ = env.reset(seed=5)
    for seen, expected in zip(policy.seen, results, strict=True):
        assert_array_equal(observation, seen)
        observation, *rest, _ = env.step(agent(observation))
        assert_same(rest, list(expected[1:4]))


@pytest.mark.parametrize("name", HYBRIDS)
def test_observation_spaces_have_the_sizes_of_the_table(name: str) -> None:
    for outputs in (False, True):
        inner = make_wrapped([OUTPUTS] if outputs else [])
        expected = SIZES[name]
        if outputs and "adrc" in name:
            expected -= 9  # ADRC does not estimate the whole state
        assert wrap(inner, HYBRIDS[name]).observation_space.shape == (expected,)


@one_of_each
def test_base_controller_given_by_name_uses_the_nominal_simulation_of_the_environment(hybrid: Make) -> None:
    heavy = Simulation({"bob_mass": 0.3})  # type: ignore[arg-type]
    for env in (make(simulation=heavy), make_vec(2, simulation=heavy)):
        assert wrap(env, hybrid).hybrid.base_controller.simulation == heavy


def test_base_controller_given_as_an_object_keeps_its_simulation() -> None:
    env = make_vec(2, simulation=Simulation({"bob_mass": 0.3}))  # type: ignore[arg-type]
    assert wrap(env, lambda: EstimateOnly(controller("lqr"))).hybrid.base_controller.simulation == Simulation()


@pytest.mark.parametrize(
    ("kind", "name"), [(EstimateOnly, "adrc-matched"), (ResidualAction, "flatness"), (BandwidthScheduling, "flatness")]
)
def test_base_controller_may_be_given_as_an_object(kind: Any, name: str) -> None:
    by_name, by_object = (wrap(make_vec(2), lambda value=value: kind(value)) for value in (name, controller(name)))
    assert_array_equal(by_name.reset(seed=0)[0], by_object.reset(seed=0)[0])
    actions = 0.1 * draw_actions(0, 5, 2)
    assert_same(run_actions(by_name, actions), run_actions(by_object, actions))


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
        expected, _ = controller(env.hybrid.base_controller_name).predict(make_vec(3, wind="windy").reset(seed=0)[0])
        assert_array_equal(env.base_action, expected)
    if env.hybrid.kind == "residual_action":
        assert_array_equal(observation[:, -4:], 10.0 * env.base_action)


@pytest.mark.parametrize("rows", [(), (3,)], ids=["one", "many"])
@one_of_each
def test_returned_observations_do_not_change_later(hybrid: Make, rows: tuple[int, ...]) -> None:
    env = wrap(make_vec(3, autoreset_mode="SameStep", **SHORT) if rows else make(), hybrid)
    returned = [env.reset(seed=0)[0], *(step[0] for step in run_actions(env, 0.1 * draw_actions(0, 3, *rows)))]
    copies = [seen.copy() for seen in returned]
    run_actions(env, 0.1 * draw_actions(1, 25 if rows else 5, *rows))
    env.reset()
    assert_same(returned, copies)


BAD_ACTIONS = {
    "too large": (np.full(4, 1.5), "must be four numbers"),
    "nan": (np.array([0.0, np.nan, 0.0, 0.0]), "must be four numbers"),
    "infinite": (np.array([np.inf, 0.0, 0.0, 0.0]), "must be four numbers"),
    "three": (np.zeros(3), r"shape .*4"),
    "one": (np.zeros(1), r"shape .*4"),
}


@pytest.mark.parametrize(("action", "names"), BAD_ACTIONS.values(), ids=BAD_ACTIONS.keys())
@pytest.mark.parametrize("rows", [(), (3,)], ids=["one", "many"])
@one_of_each
def test_refused_action_changes_nothing(hybrid: Make, rows: tuple[int, ...], action: Any, names: str) -> None:
    """The policy's action must be in [−1, 1], like the action of the environment."""
    env, copy = (wrap(make_vec(3) if rows else make(), hybrid) for _ in range(2))
    env.reset(seed=0), copy.reset(seed=0)
    bad = np.tile(action, (3, 1)) if rows else action
    assert_refused(lambda: env.step(bad), names, (ValueError, TypeError))
    actions = 0.1 * draw_actions(0, 3, *rows)
    assert_same(run_actions(env, actions), run_actions(copy, actions))


@pytest.mark.parametrize("rows", [False, True], ids=["one", "many"])
@one_of_each
def test_step_before_the_first_reset_is_refused(hybrid: Make, rows: bool) -> None:
    env = wrap(make_vec(3) if rows else make(), hybrid)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((3, 4)) if rows else np.zeros(4))


@one_of_each
def test_checkers_of_gymnasium_and_sb3_pass(hybrid: Make) -> None:
    with warnings.catch_warnings(action="error"):
        check_with_sb3(wrap(make(), hybrid))
    with warnings.catch_warnings(record=True, action="always") as caught:
        check_with_gymnasium(wrap(make(), hybrid), skip_render_check=True)
    (warning,) = caught
    assert "is different from the unwrapped version" in str(warning.message)


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


@one_of_each
def test_wrappers_accept_plain_data(hybrid: Make) -> None:
    for env in (make(), make_vec(2)):
        wrapper = wrap(env, lambda: hybrid().as_data())  # type: ignore[arg-type, return-value]
        assert type(wrapper.hybrid) is type(hybrid())
        assert wrapper.hybrid.as_data() == hybrid().as_data()


def make_one_or_many(many: bool) -> Any:
    return make_vec(2) if many else make()


BAD: dict[str, tuple[Callable[[bool], Any], str, Any]] = {
    "inside a history": (
        lambda many: wrap(make_wrapped_vec(2, [HISTORY]) if many else make_wrapped([HISTORY]), HYBRIDS["scheduling"]),
        "observations of 36 or 27 numbers, not of .*116.*: put its wrapper inside",
        ValueError,
    ),
    "twice": (
        lambda many: wrap(wrap(make_one_or_many(many), HYBRIDS["scheduling"]), HYBRIDS["scheduling"]),
        "36 or 27 numbers, not of .*45",
        ValueError,
    ),
    "another environment": (
        lambda many: wrap(gym.make_vec("CartPole-v1", 2) if many else gym.make("CartPole-v1"), HYBRIDS["scheduling"]),
        "36 or 27 numbers",
        ValueError,
    ),
    "an unknown controller": (
        lambda many: wrap(make_one_or_many(many), lambda: ResidualAction("nix")),
        "there is no controller 'nix'; there are adrc-paper",
        ValueError,
    ),
    "zero action scale": (
        lambda many: wrap(make_one_or_many(many), lambda: ResidualAction("flatness", 0.0)),
        "action_scale must be above zero",
        ValueError,
    ),
    "no bandwidths": (
        lambda many: wrap(make_one_or_many(many), lambda: BandwidthScheduling("adrc-matched")),
        "only the flatness-based controller has bandwidths to scale",
        TypeError,
    ),
}


@pytest.mark.parametrize("many", [False, True], ids=["one", "many"])
@pytest.mark.parametrize(("call", "names", "kind"), BAD.values(), ids=BAD.keys())
def test_impossible_hybrid_is_refused(call: Callable[[bool], Any], names: str, kind: Any, many: bool) -> None:
    assert_refused(lambda: call(many), names, kind)
